from pathlib import Path

import pytest

from process_runtime.supervisor import ChildExit
from tests.soak.clean_end import STOP_WITHIN_S, clean_end_verdict
from tests.soak.promises import Verdict
from tests.soak.schedule import Kind
from tests.unit.soak.made_up import at, fault


def end(
    tmp_path: Path,
    *exits: tuple[int, ChildExit],
    log: str = "a line",
    processes: tuple[str, ...] = (),
    stop_s: float = 1.0,
) -> Verdict:
    (tmp_path / "left").mkdir(exist_ok=True)
    (tmp_path / "bridge.log").write_text(log)
    faults = [fault(Kind.BRIDGE_KILLED, 5.0, target="bridge")]
    logs = [tmp_path / "bridge.log"]
    return clean_end_verdict(exits, faults, logs, processes, tmp_path / "left", stop_s)


def ended(name: str, second: float) -> tuple[int, ChildExit]:
    return at(second), ChildExit(name, -9, 1.0, "")


def test_a_killed_process_may_end_and_no_other(tmp_path: Path) -> None:
    assert end(tmp_path, ended("robot/bridge", 5.2)).kept is True
    assert end(tmp_path, ended("robot/bridge", 25.0)).kept is False
    assert end(tmp_path, ended("robot/coordinator", 5.2)).kept is False


@pytest.mark.parametrize(
    "left",
    [{"log": "Traceback (most recent"}, {"processes": ("42",)}, {"stop_s": STOP_WITHIN_S * 2}],
)
def test_whatever_is_left_or_late_breaks_it(tmp_path: Path, left: dict[str, object]) -> None:
    assert end(tmp_path, **left).kept is False  # type: ignore[arg-type] # one of three


def test_a_temporary_file_that_is_left_breaks_it(tmp_path: Path) -> None:
    (tmp_path / "left").mkdir()
    (tmp_path / "left" / "socket").touch()
    assert [broken.what for broken in end(tmp_path).breaks] == ["file socket is left"]
