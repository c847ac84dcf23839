from pathlib import Path

import pytest
from msgspec.structs import replace

from clustermcl.runtime.folders import owned
from clustermcl.runtime.settings import Settings, ZenohSettings

SETTINGS = Settings()
OTHER = replace(SETTINGS, zenoh=ZenohSettings(router="tcp/127.0.0.1:7448"))


def test_two_robots_of_one_name_do_not_share_a_folder(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder = tmp_path / "new"
    with owned(folder, SETTINGS) as first, owned(folder, OTHER) as second:
        assert (first, second) == (True, False)
        assert str(folder) in caplog.text
        assert "set robot.name" in caplog.text
        with owned(folder, SETTINGS) as of_the_same_robot:
            assert of_the_same_robot, "its coordinator takes over from a frozen one"
    with owned(folder, OTHER) as later:
        assert later


def test_a_folder_that_cannot_be_written_is_not_claimed(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with owned(tmp_path / "file", SETTINGS) as is_own:
        assert is_own, "writing logs the problem"
