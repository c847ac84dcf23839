from pathlib import Path

import numpy as np
import pytest

from clustermcl.protocol.errors import MapFileError
from clustermcl.recordings.maps.map_file import load_map, map_file_of
from tests.unit.recordings.bags import FORMS, grid, scan, written

CELLS = [[0, 100, -1], [50, 0, 99]]
S = 1_000_000_000


@pytest.mark.parametrize("form", FORMS)
def test_a_bag_s_map_is_read_by_the_thresholds_of_nav2(tmp_path: Path, form: str) -> None:
    grid_map = load_map(written(tmp_path, form, [grid(S, CELLS), scan(2 * S)]))
    assert grid_map.cells.tolist() == [[0, 1, -1], [-1, 0, 1]]
    assert grid_map.cell_m == 0.05  # which a message has as a 32 bit number
    assert grid_map.map_from_grid == pytest.approx((-1.0, 2.0, 0.5))


def test_a_map_of_probabilities_has_walls_and_a_remark(tmp_path: Path) -> None:
    """As SLAM publishes it: free from 1 % on, walls up to 98 %; AMCL would use no cell."""
    grid_map = load_map(written(tmp_path, "mcap", [grid(S, [[1, 25, 26, -1], [64, 65, 98, 99]])]))
    assert grid_map.cells.tolist() == [[0, 0, -1, -1], [-1, 1, 1, 1]]
    (remark,) = grid_map.remarks
    assert "2 cells of up to 25 % are free, 3 from 65 % occupied, 2 between are" in remark


def test_the_last_map_on_a_topic_is_loaded_and_a_costmap_only_by_its_name(tmp_path: Path) -> None:
    costmap = grid(S, [[0, 0]], topic="/local_costmap/costmap")
    path = written(tmp_path, "mcap", [costmap])
    with pytest.raises(MapFileError, match=r"no map .* /local_costmap/costmap; name a map file"):
        load_map(path)
    assert load_map(f"{path}#/local_costmap/costmap").cells.shape == (1, 2)
    sent = [costmap, grid(S, [[-1, 0]]), scan(2 * S), grid(3 * S, CELLS)]
    assert load_map(written(tmp_path / "two", "mcap", sent)).cells.shape == (2, 3)


def test_maps_of_two_robots_need_a_topic_name(tmp_path: Path) -> None:
    sent = [grid(S, CELLS, topic="/r1/map"), grid(S, [[0]], topic="/r2/map")]
    path = written(tmp_path, "mcap", sent)
    with pytest.raises(MapFileError, match="/r1/map, /r2/map"):
        load_map(path)
    assert load_map(f"{path}#/r2/map").cells.tolist() == [[0]]


@pytest.mark.parametrize(
    ("cells", "problem"),
    [(np.zeros((0, 0)), "0 cells for 0 x 0"), ([[100, -1]], "no cell is free")],
)
def test_an_invalid_map_message_is_refused(
    tmp_path: Path, cells: list[list[int]], problem: str
) -> None:
    path = written(tmp_path, "mcap", [grid(S, cells)])
    with pytest.raises(MapFileError, match=f"/map: {problem}"):
        load_map(path)


def test_a_bag_provides_the_map_unless_another_map_file_is_named(tmp_path: Path) -> None:
    path = str(written(tmp_path, "ros1", [grid(S, CELLS)]))
    assert map_file_of("", path) == path
    assert map_file_of("map.yaml", path) == "map.yaml"
    assert map_file_of("", str(tmp_path / "robot.log")) == ""
