"""A simulated robot with a dead laser: the covariance covers the error of odometry."""

import numpy as np
import pytest
from msgspec.structs import replace

from coordinator.belief.outcome import Outcome
from coordinator.pose_tracker import PoseTracker
from particle_filter.poses import wrap_angle
from particle_filter.settings import MotionSettings
from process_runtime.settings import BridgeSettings, CoordinatorSettings
from protocol.answers import PoseAnswer
from protocol.message import PoseTuple
from protocol.pose_arrays import covariance_matrix
from protocol.steps import OdometryReading
from robot_simulator.simulation import Simulation
from robot_simulator.worlds.catalogue import world
from tests.unit.coordinator.reports import NO_SPREAD
from tests.unit.evaluation.places import outcome, place

DRIVEN_NS = 60_000_000_000
"""Some 30 m."""
UNLIKELY = 16.27
"""Of chi-square with three degrees of freedom, one in a thousand is more."""


def outcome_at(map_from_robot: PoseTuple) -> Outcome:
    here = replace(place(1.0, map_from_robot), covariance=NO_SPREAD)
    return outcome("localized", here, elsewhere=0.0)


@pytest.mark.parametrize("seed", [3, 4, 5])
def test_the_covariance_contains_the_true_pose(seed: int) -> None:
    tracker = PoseTracker.of("c", CoordinatorSettings(), MotionSettings(), BridgeSettings())
    answers: list[tuple[PoseAnswer, PoseTuple]] = []
    for tick in Simulation(world("cross_feature"), seed=seed, remembered_s=1.0):
        for reading in tick.readings:
            if isinstance(reading, OdometryReading):
                tracker.odometry(reading.stamp_ns, reading.odom_from_robot, reading.stamp_ns)
                if not answers:
                    tracker.weighed(reading.stamp_ns, reading.odom_from_robot)
                    tracker.believed(outcome_at(tick.map_from_robot), reading.odom_from_robot)
        answers.append((tracker.answer(reading.stamp_ns, workers=4), tick.map_from_robot))
        if reading.stamp_ns > DRIVEN_NS:
            break
    for answer, truth in answers[1:]:
        assert answer.pose is not None
        assert answer.covariance is not None
        off = np.subtract(answer.pose, truth)
        off[2] = wrap_angle(float(off[2]))
        assert off @ np.linalg.solve(covariance_matrix(answer.covariance), off) < UNLIKELY
    last, truth = answers[-1]
    assert last.freshness == "dead_reckoning"
    assert last.pose is not None
    assert np.hypot(*np.subtract(last.pose, truth)[:2]) > 0.3, "where it did not look"
