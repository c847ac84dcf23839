from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from clustermcl.commands.command import app
from clustermcl.protocol.errors import ClusterMclError, RecordingError
from clustermcl.runtime.settings import Settings
from clustermcl.runtime.settings_file import load_settings
from tests.unit.recordings.bags import grid, scan, written

NAMES = ["--scan-topic", "/a", "--odom-topic", "/b", "--odom-frame", "c", "--base-frame", "d"]


@pytest.mark.parametrize("command", [["check", "map.yaml"], ["demo"], ["changes"]])
def test_topics_and_frames_named_on_the_command_line_are_settings(
    command: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    read: list[Settings] = []

    def loaded(*given: Any) -> Settings:
        read.append(load_settings(*given))
        return read[0]

    monkeypatch.setattr("clustermcl.commands.options.load_settings", loaded)
    words = [*command, "--recording", "robot.bag", *NAMES, "--set", "bridge.laser_x_m=0.2"]
    assert isinstance(CliRunner().invoke(app, words).exception, ClusterMclError), "there is no bag"
    bridge = read[0].bridge
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
