"""The soak test itself, short: what is promised is kept, and what is broken is noticed."""

import json
import os
import signal
from pathlib import Path

import pytest

from tests.integration.system.commands import typed
from tests.integration.waiting import wait_until

MINUTES = 3.0
SEED = 7


@pytest.mark.timeout(420)
def test_three_minutes_of_chaos_break_no_promise(short_folder: str, tmp_path: Path) -> None:
    file, logs = tmp_path / "soak.json", tmp_path / "logs"
    words = [
        "soak", "--chaos", "--minutes", f"{MINUTES}", "--fault-every-s", "10",
        "--seed", f"{SEED}", "--json", str(file), "--logs", str(logs),
    ]  # fmt: skip
    environment = {**os.environ, "TMPDIR": short_folder}
    with typed(*words, folder=tmp_path, environment=environment) as soak:
        soak.wait_for("0.0 of 3 min", deadline_s=90.0)
        code = soak.popen.wait(MINUTES * 60.0 + 60.0)
        assert code == 0, soak.out + soak.err
        soak.assert_nothing_runs()
    result = json.loads(file.read_text())
    assert result["kept"]
    assert len({fault["kind"] for fault in result["faults"]}) == 12, "one of each kind"
    assert list(Path(short_folder).iterdir()) == []


def test_ctrl_c_ends_it_with_what_was_seen_so_far(short_folder: str, tmp_path: Path) -> None:
    words = ["soak", "--minutes", "5", "--world", "hall", "--workers", "2"]
    words += ["--set", "belief.clusters=2"]
    environment = {**os.environ, "TMPDIR": short_folder}
    with typed(*words, folder=tmp_path, environment=environment) as soak:
        soak.wait_for("0.0 of 5 min", deadline_s=90.0)
        wait_until(lambda: "step" in soak.out)
        assert soak.end(signal.SIGINT) in (1, 130)
        soak.assert_nothing_runs()
    assert "the pose is answered while a coordinator is up" in soak.out
    assert "Traceback" not in soak.err
    assert list(Path(short_folder).iterdir()) == []
