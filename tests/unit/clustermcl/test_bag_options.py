from pathlib import Path

import pytest
from typer.testing import CliRunner

from clustermcl.commands.command import app
from clustermcl.protocol.errors import RecordingError
from clustermcl.runtime.settings import Settings
from tests.unit.recordings.bags import grid, scan, written

NAMES = ["--scan-topic", "/a", "--odom-topic", "/b", "--odom-frame", "c", "--base-frame", "d"]


@pytest.mark.parametrize(
    ("command", "runs"),
    [
        (["evaluate", "robot.bag"], "clustermcl.evaluation.evaluate.run_evaluate"),
        (["demo", "--recording", "robot.bag"], "clustermcl.commands.demo.run_demo"),
    ],
)
def test_topics_and_frames_named_on_the_command_line_are_settings(
    command: list[str], runs: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    reported: list[Settings] = []

    def record_run(*given: object, **_options: object) -> None:
        reported.extend(each for each in given if isinstance(each, Settings))

    monkeypatch.setattr(runs, record_run)
    result = CliRunner().invoke(app, [*command, *NAMES, "--set", "bridge.laser_x_m=0.2"])
    assert result.exit_code == 0, result.output
    bridge = reported[0].bridge
    named = (bridge.scan_topic, bridge.odom_topic, bridge.odom_frame, bridge.base_frame)
    assert named == ("/a", "/b", "c", "d")
    assert bridge.laser_x_m == 0.2


@pytest.mark.parametrize("command", [["evaluate"], ["demo", "--recording"]])
def test_a_bag_with_two_scan_topics_needs_a_scan_topic_but_no_map_file(
    tmp_path: Path, command: list[str]
) -> None:
    sent = [grid(1, [[0, 100]]), scan(2), scan(3, topic="/rear/scan")]
    path = written(tmp_path, "mcap", sent)
    result = CliRunner().invoke(app, [*command, str(path)])
    assert isinstance(result.exception, RecordingError)
    assert "--scan-topic" in str(result.exception)
