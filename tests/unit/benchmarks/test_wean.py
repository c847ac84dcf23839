"""Logs of Wean Hall, which the project does not read, reach the localizer as others do."""

from pathlib import Path

from benchmarks.wean import WeanRobot
from benchmarks.worlds import world
from clustermcl.evaluation.run import Case, course_of
from clustermcl.runtime.settings import BridgeSettings
from tests.maps import write_map


def test_a_log_of_wean_hall_is_read(tmp_path: Path) -> None:
    ranges = " ".join(["250"] * 180)
    log = tmp_path / "robotdata.log"
    log.write_text(
        "".join(
            f"O {100 * t} 0 0 {t}\nL {100 * t} 0 0 {100 * t + 25} 0 0 {ranges} {t}.1\n"
            for t in range(4)
        )
    )
    robot = WeanRobot(recording=log, map=write_map(world("hall").map, tmp_path, "map"))
    scans = [scan for scan, _ in course_of(Case(robot=robot), 0, BridgeSettings()).steps]
    assert [scan.odom_from_robot[0] for scan in scans] == [0.0, 1.0, 2.0, 3.0]
    assert all((scan.ranges.array() == 2.5).all() for scan in scans)
