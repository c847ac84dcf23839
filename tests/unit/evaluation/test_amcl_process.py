"""AMCL's filter on the steps of a running robot, for the second map of a demo's page."""

import pytest

from coordinator.belief.outcome import Outcome
from evaluation.amcl_process import Follower, amcl_name
from evaluation.run import ALGORITHMS
from grid_maps.map_message import to_message
from particle_filter.sensor_model import SensorModel
from process_runtime.settings import BridgeSettings
from protocol.job_events import Began, Ended, JobEvent, JobEvents, NumberedEvent
from protocol.names import LONGEST_NAME, is_name
from protocol.steps import Scan
from robot_simulator.simulation import Simulation
from robot_simulator.source import SimulatedSource, simulated_steps
from robot_simulator.worlds.catalogue import world
from tests.integration.system.conftest import SMALL
from worker.map_model import sensor_model

CROSS = world("cross")
STEPS = 8


@pytest.fixture(scope="module")
def model() -> SensorModel:
    return sensor_model(CROSS.map, SMALL.sensor, cache_folder=None)


@pytest.fixture(scope="module")
def scans() -> list[Scan]:
    source = SimulatedSource(Simulation(CROSS, seed=3), steps=STEPS)
    return [scan for scan, _ in simulated_steps(source, BridgeSettings(), CROSS.map.digest)]


@pytest.fixture
def follower(model: SensorModel) -> Follower:
    made = Follower(SMALL)
    made.use(model, to_message(CROSS.map, "bridge"))
    return made


def followed(follower: Follower, scans: list[Scan]) -> list[Outcome]:
    outcomes = []
    for scan in scans:
        follower.on_scan(scan)
        outcomes += [outcome for _, outcome in follower.advance()]
    return outcomes


def happened(*events: JobEvent) -> JobEvents:
    numbered = tuple(
        NumberedEvent(number=number, step=3, stamp_ns=0, event=event)
        for number, event in enumerate(events)
    )
    return JobEvents(sender="coordinator", term=1, events=numbered)


def test_beliefs_equal_those_of_evaluate(
    follower: Follower, model: SensorModel, scans: list[Scan]
) -> None:
    expected = [outcome for _, outcome in ALGORITHMS["amcl"](iter(scans), model, SMALL)]
    assert followed(follower, scans) == expected
    assert (follower.status("amcl").step, follower.status("amcl").state) == (7, expected[-1].state)


def test_scans_before_the_map_are_not_lost(model: SensorModel, scans: list[Scan]) -> None:
    late = Follower(SMALL)
    assert followed(late, scans[:3]) == []
    assert late.status("amcl").freshness == "none"
    late.use(model, to_message(CROSS.map, "bridge"))
    assert [outcome.step for outcome in followed(late, scans[3:])] == [0, 1, 2, 3, 4, 5, 6, 7]


def test_the_filter_restarts_when_all_places_are_dropped(
    follower: Follower, model: SensorModel, scans: list[Scan]
) -> None:
    followed(follower, scans[:3])
    follower.on_events(happened(Ended("c1", "improbable"), Ended("c2", "merged", ("c3",))))
    going_on = followed(follower, scans[3:5])
    follower.on_events(happened(Ended("c3", "forgotten")))
    again = followed(follower, scans[5:])
    fresh = [outcome for _, outcome in ALGORITHMS["amcl"](iter(scans[5:]), model, SMALL)]
    assert again == fresh
    assert going_on != fresh[:2]


def test_a_given_pose_does_not_restart_the_filter(
    follower: Follower, model: SensorModel, scans: list[Scan]
) -> None:
    before = followed(follower, scans[:3])
    follower.on_events(happened(Ended("c3", "forgotten"), Began("c4", "given", 1.0)))
    outcomes = before + followed(follower, scans[3:])
    assert outcomes == [outcome for _, outcome in ALGORITHMS["amcl"](iter(scans), model, SMALL)]


def test_a_restart_of_steps_restarts_the_filter(follower: Follower, scans: list[Scan]) -> None:
    first = followed(follower, scans)
    assert followed(follower, scans) == first


@pytest.mark.parametrize("robot", ["robot", "a" * LONGEST_NAME, "a" * 58 + "-bcdef"])
def test_the_second_robot_name_is_valid_and_different(robot: str) -> None:
    assert is_name(amcl_name(robot))
    assert amcl_name(robot) != robot
