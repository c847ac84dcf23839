from pathlib import Path

import pytest

from benchmarks.experiments.case import Case, RecordedRobot, SimulatedRobot
from benchmarks.experiments.catalogue import DATA_VARIABLE, all_cases, recorded_cases


def simulated() -> list[Case]:
    return [case for case in all_cases(Path("nowhere")) if isinstance(case.robot, SimulatedRobot)]


def touched(folder: Path, *names: str) -> None:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()


def test_recordings_are_found_by_the_names_of_their_files(tmp_path: Path) -> None:
    touched(tmp_path, "wean/robotdata2.log.xz", "wean/robotdata2.reference.tum", "wean/map.yaml")
    touched(tmp_path, "shop/log.clf.gz", "shop/map.yaml", "shop/groundtruth.tum")
    touched(tmp_path, "maps/a.yaml", "no-reference/log.clf", "README.md")
    wean, shop = recorded_cases(tmp_path)
    assert (wean.name, shop.name) == ("wean-2", "shop")
    assert wean.robot == RecordedRobot(
        recording=tmp_path / "wean/robotdata2.log.xz",
        map=tmp_path / "wean/map.yaml",
        reference=tmp_path / "wean/robotdata2.reference.tum",
    )
    assert isinstance(shop.robot, RecordedRobot)
    assert shop.robot.recording == tmp_path / "shop/log.clf.gz"


def test_without_a_folder_the_simulated_experiments_remain(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(DATA_VARIABLE, raising=False)
    simulated = all_cases()
    assert all(isinstance(case.robot, SimulatedRobot) for case in simulated)
    assert all_cases(tmp_path / "nowhere") == simulated
    assert recorded_cases(None) == ()
    touched(tmp_path, "shop/log.clf", "shop/groundtruth.tum", "shop/map.yaml")
    monkeypatch.setenv(DATA_VARIABLE, str(tmp_path))
    assert [case.name for case in all_cases()[len(simulated) :]] == ["shop", "shop-starts"]


def test_each_map_gives_a_test_with_a_simulated_robot(tmp_path: Path) -> None:
    touched(tmp_path, "ros-maps/big_depot.yaml", "carmen-maps/a.yaml", "carmen-maps/a.pgm")
    touched(tmp_path, "carmen-maps/thickwean.yaml", "carmen-maps/wean5300.yaml")
    a, depot = all_cases(tmp_path)[-2:]
    assert (a.name, depot.name) == ("map-a", "map-big-depot")
    assert depot.robot == SimulatedRobot(world=str(tmp_path / "ros-maps/big_depot.yaml"))
    assert a.role == depot.role == "test"
    assert not any("wean" in case.name for case in all_cases(tmp_path)), "a training building"
