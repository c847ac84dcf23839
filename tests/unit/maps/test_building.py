import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from clustermcl.evaluation.run import Case, SimulatedRobot, course_of
from clustermcl.filter.arrays import FREE, OCCUPIED
from clustermcl.filter.poses import between
from clustermcl.protocol.errors import MapFileError
from clustermcl.protocol.floors import ONE_MAP, Floors
from clustermcl.recordings.maps.building import GAP_M
from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.recordings.maps.map_file import load_map
from clustermcl.recordings.maps.map_message import from_message, to_message
from clustermcl.runtime.settings import BridgeSettings
from tests.maps import write_map

ROOM = np.full((20, 40), OCCUPIED, np.int8)
ROOM[1:-1, 1:-1] = FREE
GROUND = GridMap(ROOM, 0.5, (-3.0, 2.0, 0.0))
THIRD = GridMap(ROOM[:, :30], 0.5, (1.0, -4.0, 0.0))
LINKS = "links: [{name: lift, at: {ground: [1.0, 4.0], third: [3.0, -1.0]}}]\n"


def write_building(folder: Path, text: str = "", *, links: str = LINKS) -> Path:
    for name, grid_map in (("ground", GROUND), ("third", THIRD)):
        write_map(grid_map, folder, name)
    path = folder / "building.yaml"
    floors = "floors:\n  ground: ground.yaml\n  third: {map: third.yaml, height_m: 8.4}\n"
    path.write_text(text or floors + links)
    return path


def test_the_cells_of_each_floor_are_in_the_atlas_unchanged(tmp_path: Path) -> None:
    atlas = load_map(write_building(tmp_path))
    for floor, grid_map in zip(atlas.floors.floors, (GROUND, THIRD), strict=True):
        x, y, _ = atlas.floors.in_atlas(floor.name, grid_map.map_from_grid)
        row, col = round(y / 0.5), round(x / 0.5)
        rows, cols = grid_map.cells.shape
        assert (atlas.cells[row : row + rows, col : col + cols] == grid_map.cells).all()
    free = sum(int((each.cells == FREE).sum()) for each in (GROUND, THIRD))
    assert int((atlas.cells == FREE).sum()) == free
    assert [floor.height_m for floor in atlas.floors.floors] == [0.0, 8.4]
    first, second = atlas.floors.floors
    assert second.low[0] - first.high[0] >= GAP_M, "no laser sees from floor to floor"
    for name, pose in (("ground", (-3.0, 2.0, 4.0)), ("third", (15.9, 5.9, -4.0))):
        found, there = atlas.floors.on_floor(atlas.floors.in_atlas(name, pose))
        assert (found, *there) == pytest.approx((name, *pose), abs=1e-12)


def test_a_building_with_one_floor_is_its_map(tmp_path: Path) -> None:
    path = write_building(tmp_path, "\ufefffloors: {ground: ground.yaml}")  # as Windows saves
    alone, one_floor = load_map(tmp_path / "ground.yaml"), load_map(path)
    assert one_floor.digest == alone.digest
    assert one_floor.floors == ONE_MAP
    assert one_floor.floors.on_floor((1.0, 2.0, 3.0)) == ("", (1.0, 2.0, 3.0))


def test_floors_may_differ_in_resolution_and_be_turned(tmp_path: Path) -> None:
    coarse_turned = GridMap(ROOM[::2, ::2], 1.0, (5.0, 5.0, 0.5))
    path = write_building(tmp_path, links="")
    write_map(coarse_turned, tmp_path, "third")
    atlas = load_map(path)
    assert any("third: resampled to cells of 0.5 m" in remark for remark in atlas.remarks)
    rng = np.random.default_rng(0)
    shift = atlas.floors.floor("third").shift
    for x, y in rng.uniform((0.0, 0.0), (20.0, 20.0), (500, 2)):
        in_grid = between(np.array(coarse_turned.map_from_grid), np.array([x, y, 0.0]))
        if np.any(np.abs(in_grid[:2] - np.round(in_grid[:2])) < 0.36):  # half a cell's diagonal
            continue
        col, row = np.floor(in_grid[:2]).astype(int)
        rows, cols = coarse_turned.cells.shape
        if 0 <= row < rows and 0 <= col < cols:
            at = (int((y + shift[1]) / 0.5), int((x + shift[0]) / 0.5))
            assert atlas.cells[at] == coarse_turned.cells[row, col]


def test_buildings_of_multi_level_map_server_are_read(tmp_path: Path) -> None:
    (tmp_path / "maps" / "multi").mkdir(parents=True)
    write_building(tmp_path)
    path = tmp_path / "maps" / "multi" / "multimap.yaml"
    path.write_text(
        "maps:\n"
        "  01: {yaml: package://gdc/ground.yaml, origin: [0, 0, 0, 0, 0, 0]}\n"
        "  third: {yaml: ../../third.yaml, origin: [0, 0, 5, 0, 0, 0], data_directory: x}\n"
        "links:\n"
        "  - from_point: {level_id: '01', point: [1, 4, 0]}\n"
        "    to_point: {level_id: third, point: [3, -1, 0]}\n"
    )
    floors = load_map(path).floors
    assert [(floor.name, floor.height_m) for floor in floors.floors] == [
        ("01", 0.0), ("third", 5.0)
    ]  # fmt: skip
    assert floors.links[0].at == {"01": (1.0, 4.0), "third": (3.0, -1.0)}


def test_a_simulated_robot_is_on_the_same_floor_of_another_building(tmp_path: Path) -> None:
    world = write_building(tmp_path)
    other = world.with_name("other.yaml")
    other.write_text("floors: {third: third.yaml, ground: ground.yaml}")
    found = []
    for file in (None, other):
        case = Case(robot=SimulatedRobot(world=str(world), map=file), updates=1)
        course = course_of(case, 0, BridgeSettings())
        (truth,) = (truth for _, truth in course.steps if truth)
        found.append(course.map.floors.on_floor(truth))
    assert found[1][0] == found[0][0]
    assert found[1][1] == pytest.approx(found[0][1])


def test_a_building_travels_as_a_message(tmp_path: Path) -> None:
    atlas = load_map(write_building(tmp_path))
    back = from_message(to_message(atlas, "bridge"))
    assert (back.floors, back.digest) == (atlas.floors, atlas.digest)
    moved = replace(atlas, floors=Floors(atlas.floors.floors[:1]))
    assert moved.digest != atlas.digest


TWO = "floors: {ground: ground.yaml, third: third.yaml}\n"


@pytest.mark.parametrize(("text", "says"), [
    ("floors: {ground: ground.yaml, third: missing.yaml}", "floor 'third': .*missing.yaml"),
    ("floors: {ground: ground.yaml, third: building.yaml}", "a floor is a single map"),
    ("floors: {ground: ground.png, third: third.yaml}", "floor 'ground': .*is an image"),
    ("floors: {}", "not a building"),
    ("floors:\n  1: ground.yaml\n  '1': third.yaml", "building.yaml:3: '1' is there twice"),
    ("floors: [ground.yaml]", "not a building"),
    ("floors: {ground: {map: ground.yaml, heigth_m: 1}}", "heigth_m"),
    ("floors: {ground: {map: ground.yaml, height_m: .nan}}", "not a building"),
    ("floors: {ground: {map: &a ground.yaml}, third: *a}", "aliases"),
    (f"floors: {{{', '.join(f'f{n}: ground.yaml' for n in range(65))}}}", "length <= 64"),
    (TWO + "links: [{name: lift, at: {ground: [1, 4], attic: [3, -1]}}]", "unknown floor 'attic'"),
    (TWO + "links: [{name: lift, at: {ground: [1, 4]}}]", "length >= 2"),
    (TWO + "links: [{name: lift, at: {ground: [.nan, 4], third: [3, -1]}}]", "not a building"),
    (TWO + "links: [{name: lift, at: {ground: [1, 4], third: [300, 1]}}]",
     "'lift' is outside of floor 'third'"),
    (TWO + "links: [{name: a, radius_m: -1, at: {ground: [1, 4], third: [3, 1]}}]", "radius_m"),
    (TWO + "links: [{name: a, radius_m: 1e9, at: {ground: [1, 4], third: [3, 1]}}]", "radius_m"),
    ("maps: {ground: {yaml: ground.yaml, origin: [0, .inf, 0]}}", "not a building"),
    ("maps: {a: {yaml: ground.yaml}, b: {yaml: third.yaml}}\nlinks: [{from_point: {level_id: a, "
     "point: [0, 4, 0]}, to_point: {level_id: a, point: [1, 4, 0]}}]", "ends on one floor"),
    (TWO + "x: [" * 5000, "not YAML"),
])  # fmt: skip
def test_an_unusable_building_is_refused(tmp_path: Path, text: str, says: str) -> None:
    with pytest.raises(MapFileError, match=says) as refused:
        load_map(write_building(tmp_path, text))
    assert refused.value.path == tmp_path / "building.yaml"


def test_an_atlas_that_is_too_large_is_refused_before_it_is_made(tmp_path: Path) -> None:
    path = write_building(tmp_path, links="")
    write_map(GridMap(ROOM, 1e-5, (0.0, 0.0, 0.0)), tmp_path, "third")
    with pytest.raises(MapFileError, match=r"floor 'third': with it.*cells of 1e-05 m"):
        load_map(path)


@pytest.mark.parametrize("filler", ["\n", " ", "{", "'", "floors", " \n", "{\n"])
def test_a_file_of_fillers_is_refused_soon(tmp_path: Path, filler: str) -> None:
    path = tmp_path / "map.yaml"
    path.write_text(filler * (65_000 // len(filler)))
    begin_s = time.process_time()
    with pytest.raises(MapFileError):
        load_map(path)
    assert time.process_time() - begin_s < 5.0  # PyYAML needs 1 s
