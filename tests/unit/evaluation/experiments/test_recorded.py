import shutil
from pathlib import Path

import pytest

from evaluation.experiments.case import RecordedRobot, SimulatedRobot
from evaluation.experiments.catalogue import simulated_cases
from evaluation.experiments.map_cases import map_cases
from evaluation.experiments.recorded import DATA_VARIABLE, recorded_cases
from evaluation.experiments.run import available
from tests.unit.recordings import data_folder


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


@pytest.mark.parametrize(("cell_m", "asked"), [(0.05, 2), (0.1, 1)])
def test_centimetres_are_asked_only_where_cells_are_fine(
    tmp_path: Path, cell_m: float, asked: int
) -> None:
    touched(tmp_path, "shop/log.clf", "shop/groundtruth.tum")
    header = f"image: a.pgm\nresolution: {cell_m}\norigin: [0, 0, 0]\nnegate: 0\n"
    thresholds = "occupied_thresh: 0.65\nfree_thresh: 0.2\n"
    (tmp_path / "shop/map.yaml").write_text(header + thresholds)
    (case,) = recorded_cases(tmp_path)
    assert sum(figure.asks for figure in case.figures) == asked


def test_absent_recordings_are_said_and_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(DATA_VARIABLE, raising=False)
    cases, left_out = available(None)
    assert all(isinstance(case.robot, SimulatedRobot) for case in cases)
    assert left_out == (f"Recordings are left out: give --data or set {DATA_VARIABLE}.",)
    monkeypatch.setenv(DATA_VARIABLE, str(tmp_path))
    assert available(None)[1] == (f"Recordings are left out: none in {tmp_path}.",)
    touched(tmp_path, "shop/log.clf", "shop/groundtruth.tum", "shop/map.yaml")
    cases, left_out = available(None)
    assert cases[-1].name == "shop"
    assert left_out == (f"Left out, not in {tmp_path}: wean-1, wean-2, wean-3.",)
    shutil.rmtree(tmp_path / "shop")


def test_of_every_map_there_is_a_test_with_a_simulated_robot(tmp_path: Path) -> None:
    touched(tmp_path, "ros-maps/big_depot.yaml", "carmen-maps/a.yaml", "carmen-maps/a.pgm")
    a, depot = map_cases(tmp_path)
    assert (a.name, depot.name) == ("map-a", "map-big-depot")
    assert depot.robot == SimulatedRobot(world=str(tmp_path / "ros-maps/big_depot.yaml"))
    assert a.role == depot.role == "test"
    touched(tmp_path, "carmen-maps/thickwean.yaml", "carmen-maps/wean5300.yaml")
    assert map_cases(tmp_path) == (a, depot)  # those two show a training building
    assert map_cases(None) == map_cases(tmp_path / "nowhere") == ()
    assert {a.name, depot.name} <= {case.name for case in available(tmp_path)[0]}


def test_buildings_that_constants_were_chosen_on_are_named_so() -> None:
    others = [case.name for case in simulated_cases() if case.role != "training"]
    assert others == ["cross-feature", "hall-last-year"]
    if data_folder().is_dir():
        recorded = [case.name for case in recorded_cases(data_folder()) if case.role == "training"]
        assert recorded == ["wean-1", "wean-2", "wean-3", "fr101", "intel"]


def test_with_and_without_visibility_are_the_same_experiment_but_for_that() -> None:
    cases = {case.name: case for case in simulated_cases()}
    on, off = cases["gates"], cases["gates-no-visibility"]
    assert (on.robot, on.updates, on.symmetry) == (off.robot, off.updates, off.symmetry)
    assert off.settings == ("sensor.visibility_particles=0",)
    assert {"mcl", "mcl-visibility"} <= set(on.baselines)
    assert off.baselines == ("mcl",)
    asked = [[figure.measure for figure in case.figures if figure.asks] for case in (on, off)]
    assert asked == [
        ["all_tracked_until_seen_share", "localized"],
        ["all_tracked_until_seen_share"],
    ]


def test_the_shared_recordings_are_all_found() -> None:
    if not data_folder().is_dir():
        pytest.skip(f"{data_folder()} is not there; set CLUSTERMCL_DATA to have it")
    names = [case.name for case in recorded_cases(data_folder())]
    assert names[:3] == ["wean-1", "wean-2", "wean-3"]
    assert {"aces", "intel", "fr079", "crob-jarvis"} <= set(names)
