from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageColor
from typer.testing import CliRunner

from clustermcl.commands.check import MOST_CELLS
from clustermcl.commands.command import app
from clustermcl.evaluation.map_check.drawing import ALIKE, LANDMARK, UNIQUE
from clustermcl.filter.arrays import OCCUPIED, UNKNOWN
from clustermcl.protocol.errors import MapFileError, RecordingError
from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.simulator.worlds.catalogue import world
from tests.maps import write_map


@pytest.fixture
def two_rooms(tmp_path: Path) -> Path:
    """Twins: two rooms that mirror each other about the door between them, turned."""
    cells = np.full((100, 240), UNKNOWN, np.int8)
    room = np.zeros((100, 120), np.int8)
    room[[0, 1, -2, -1], :] = room[:, [0, 1]] = OCCUPIED
    room[20:40, 30:60] = OCCUPIED
    room[:40, -2:] = room[60:, -2:] = OCCUPIED
    cells[:, :120], cells[:, 120:] = room, room[::-1, ::-1]
    return write_map(GridMap(cells, 0.05, (0.0, 0.0, 0.0)), tmp_path, "rooms")


def test_places_that_look_alike_are_printed_as_text(
    two_rooms: Path, caplog: pytest.LogCaptureFixture
) -> None:
    two_rooms.write_text(two_rooms.read_text().replace("0.0]", ".nan]"))
    result = CliRunner().invoke(app, ["check", str(two_rooms), "--places", "6"])
    assert result.exit_code == 0, result.output
    assert (result.output + caplog.text).count("its yaw is not a number") == 1
    lines = [line for line in result.stdout.splitlines() if "its yaw" not in line]
    assert lines[0].endswith("rooms.yaml: 240 x 100 cells of 0.05 m, 12.0 x 5.0 m")
    assert lines[2].startswith("0 of 6 places are unique")
    assert lines[3] == "  these 2 places look alike:"
    assert lines[-1].startswith("* 6 of 6 places look like others")


def test_an_unreadable_file_is_refused(two_rooms: Path) -> None:
    missing = CliRunner().invoke(app, ["check", "nowhere.yaml"])
    assert isinstance(missing.exception, MapFileError)
    no_log = CliRunner().invoke(app, ["check", str(two_rooms), "--recording", "nowhere.log"])
    assert isinstance(no_log.exception, RecordingError)


def test_a_map_that_is_too_large_is_refused(tmp_path: Path) -> None:
    """Looking at 16,384 x 16,384 known cells took 5.8 GB, or ended with a traceback."""
    side = round(MOST_CELLS**0.5) + 1
    cells = np.zeros((side, side), np.int8)
    cells[0] = OCCUPIED
    file = write_map(GridMap(cells, 0.05, (0.0, 0.0, 0.0)), tmp_path, "large")
    refused = CliRunner().invoke(app, ["check", str(file)]).exception
    assert isinstance(refused, MapFileError)
    assert "8193 x 8193 cells are known; the limit of check is 67108864" in str(refused)


def test_look_alikes_and_landmarks_are_drawn_and_those_outside_are_remarked(tmp_path: Path) -> None:
    """The cross has four equal arms."""
    lines = "- {id: in, x: 0.0, y: 0.0}\n- {id: far, x: 900.0, y: 0.0}\n"
    (tmp_path / "landmarks.yaml").write_text(f"landmarks:\n{lines}")
    map_file = write_map(world("cross").map, tmp_path, "cross")
    words = ["check", str(map_file), "--places", "8", "--report", str(tmp_path / "report.png")]
    done = CliRunner().invoke(app, words)
    assert "1 of 2 landmarks lie outside the map, such as far" in done.output
    with Image.open(tmp_path / "report.png") as drawn:
        found = {colour for _, colour in drawn.convert("RGB").getcolors(2**24)}
    alike, landmark, unique = map(ImageColor.getrgb, (ALIKE, LANDMARK, UNIQUE))
    assert {alike, landmark} < found
    assert unique not in found


def test_an_unwritable_picture_is_refused_before_the_check(tmp_path: Path) -> None:
    map_file = write_map(world("cross").map, tmp_path, "cross")
    words = ["check", str(map_file), "--report"]
    refused = CliRunner().invoke(app, [*words, str(tmp_path / "no" / "x.png")])
    assert "its folder does not exist" in str(refused.exception)
    page = CliRunner().invoke(app, [*words, str(tmp_path / "x.html")]).exception
    assert "its name must end in .png" in str(page)
