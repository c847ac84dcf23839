from benchmarks.experiments.case import SimulatedRobot
from benchmarks.people import CrowdSimulation
from benchmarks.worlds import gates
from clustermcl.evaluation.run import Case, course_of
from clustermcl.runtime.settings import BridgeSettings


def test_a_robot_of_an_experiment_drives_among_people_in_a_world_of_the_experiments() -> None:
    case = Case(robot=SimulatedRobot(world="gates", people=3), updates=1)
    course = course_of(case, 0, BridgeSettings())
    assert isinstance(course.simulation, CrowdSimulation)
    assert course.map.digest == gates().map.digest
    assert len(list(course.steps)) == 1
