from pathlib import Path

import pytest

from soak_test.leftovers import kept_logs


def test_logs_that_cannot_be_kept_do_not_take_the_result_with_them(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    log = tmp_path / "worker.log"
    log.write_text("a line")
    kept_logs([log], tmp_path / "kept")
    assert (tmp_path / "kept" / "worker.log").read_text() == "a line"
    assert not caplog.messages
    kept_logs([log], log / "kept")
    assert caplog.messages[0].startswith("the logs cannot be kept: ")
