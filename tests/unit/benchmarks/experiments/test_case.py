from pathlib import Path

from benchmarks.experiments.case import SimulatedRobot
from benchmarks.people import CrowdSimulation
from benchmarks.worlds import gates
from clustermcl.evaluation.run import Case, course_of
from clustermcl.runtime.settings import BridgeSettings
from tests.maps import write_map


def test_a_robot_of_an_experiment_drives_among_people_in_a_world_of_the_experiments() -> None:
    case = Case(robot=SimulatedRobot(world="gates", people=3), updates=1)
    course = course_of(case, 0, BridgeSettings())
    assert isinstance(course.simulation, CrowdSimulation)
    assert course.map.digest == gates().map.digest
    assert len(list(course.steps)) == 1


def test_a_robot_of_an_experiment_drives_in_a_map_file(tmp_path: Path) -> None:
    file = write_map(gates().map, tmp_path, "building")
    course = course_of(Case(robot=SimulatedRobot(world=str(file)), updates=1), 0, BridgeSettings())
    assert course.map.cells.shape == gates().map.cells.shape
    assert len(list(course.steps)) == 1
