from pathlib import Path

import pytest
from typer.testing import CliRunner

from clustermcl.commands.command import app
from clustermcl.protocol.errors import RecordingError, SettingsError
from clustermcl.runtime.output_files import OutputError
from clustermcl.view.admission import parsed_address
from clustermcl.view.recorded_run import view_recording
from tests.unit.recordings.bags import scan, written


@pytest.mark.parametrize("name", ["none", "robot.mcap", "."])
def test_a_path_without_a_recorded_run_is_refused_with_a_remedy(tmp_path: Path, name: str) -> None:
    if name != "none":
        written(tmp_path, "mcap", [scan(2, [1.0])]).rename(tmp_path / "robot.mcap")
    page = parsed_address("127.0.0.1:0")
    words = "no such file" if name == "none" else "demo --view --recording"
    with pytest.raises(RecordingError, match=words):
        view_recording(tmp_path / name, page)


@pytest.mark.parametrize("name", ["now", "now.jpg"])
def test_a_snapshot_is_a_png_file(tmp_path: Path, name: str) -> None:
    refused = CliRunner().invoke(app, ["snapshot", str(tmp_path / name)]).exception
    assert isinstance(refused, SettingsError)
    assert "is a .png file" in str(refused)


def test_an_unwritable_snapshot_file_is_refused_before_connecting(tmp_path: Path) -> None:
    refused = CliRunner().invoke(app, ["snapshot", str(tmp_path / "none" / "now.png")]).exception
    assert isinstance(refused, OutputError)
    assert "folder does not exist" in str(refused)
