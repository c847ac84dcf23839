from pathlib import Path

import pytest

from clustermcl.protocol.errors import RecordingError, SettingsError
from clustermcl.runtime.settings import BridgeSettings
from clustermcl.sensor_bridge.process import source_of
from clustermcl.sensor_bridge.recorded import opened, steps_of
from tests.unit.recordings.logs import flaser, odom, recording_of


def test_a_recording_without_a_usable_scan_is_refused(tmp_path: Path) -> None:
    recording = recording_of(tmp_path, *(flaser(t, ranges=["nan"] * 180) for t in range(3)))
    with pytest.raises(RecordingError, match=r"none of its 3 scans can be used \(no_returns: 3\)"):
        list(steps_of(recording, BridgeSettings(), "digest"))


def test_only_the_last_step_is_marked_as_last(tmp_path: Path) -> None:
    recording = recording_of(tmp_path, *(flaser(t, (t, 0, 0)) for t in range(3)))
    steps = steps_of(recording, BridgeSettings(), "digest")
    assert [step.last for step in steps] == [False, False, True]


def test_bad_lines_and_scans_that_are_left_out_are_reported(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "robot.log"
    ends = f"{path}: odometry ends 3 s before the scans, which are left out"
    for lines, warned in (
        ([flaser(1), "ODOM x", flaser(2)], f"{path}:2: 1 bad line left out"),
        ([odom(1), flaser(1), flaser(4)], ends),
        ([odom(1), flaser(1), odom(3), flaser(4)], ""),
    ):
        caplog.clear()
        path.write_text("\n".join(lines))
        opened(str(path), BridgeSettings())
        assert warned in caplog.text
        assert bool(warned) == bool(caplog.text)


@pytest.mark.parametrize(
    ("source", "error", "words"),
    [
        ("nowhere.log", RecordingError, r"nowhere\.log"),
        ("sim:cross", SettingsError, "sim:cross.*clustermcl.simulator"),
    ],
)
def test_a_source_that_cannot_be_read_is_refused(
    source: str, error: type[Exception], words: str
) -> None:
    with pytest.raises(error, match=words):
        source_of(BridgeSettings(source=source))
