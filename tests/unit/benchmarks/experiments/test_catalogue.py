from pathlib import Path

from benchmarks.experiments.case import Case, RecordedRobot, SimulatedRobot
from benchmarks.experiments.catalogue import all_cases, recorded_cases


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
