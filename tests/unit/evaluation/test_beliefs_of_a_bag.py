"""A real ROS 1 bag against the CARMEN log that others made of it."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from coordinator.belief.outcome import Outcome
from evaluation.course import Case, RecordedRobot
from evaluation.run import ALGORITHMS, Run
from particle_filter.settings import BeliefSettings
from process_runtime.settings import BridgeSettings, Settings
from protocol.message import PoseTuple
from protocol.steps import Scan
from recordings.recording import open_recording
from sensor_bridge.recorded import steps_of
from tests.unit.recordings import recording_or_skip

LASER = "/driver_laser_security/laser_scan"
SETTINGS = Settings(
    belief=BeliefSettings(off_map_probability=0.0), bridge=BridgeSettings(scan_topic=LASER)
)
"""Off the map is left out: this map is one that the filter doubts (docs/unknown.md), where the last
digit of a log decides whether a beam counts as on a wall or next to it."""


@pytest.fixture(scope="module")
def bag() -> Path:
    return recording_or_skip("crob-jarvis/jarvis_circular_path_fast.bag")


@pytest.fixture(scope="module")
def cache_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="module")
def believed(bag: Path, cache_folder: Path) -> list[Outcome]:
    return list(beliefs(bag, cache_folder))


def beliefs(recording: Path, cache_folder: Path) -> Iterator[Outcome]:
    grid_map = recording_or_skip("crob-jarvis/map.yaml")
    robot = RecordedRobot(recording=recording, map=grid_map, reference=None)
    follow = ALGORITHMS["cluster-mcl"]
    run = Run(case=Case(robot=robot), follow=follow, seed=0, settings=SETTINGS)
    _, steps = run.begun(cache_folder)
    return (outcome for _, outcome, _ in steps)


def steps(recording: Path) -> list[Scan]:
    bridge = SETTINGS.bridge
    return list(steps_of(open_recording(recording, bridge), bridge, "digest"))


def best(outcome: Outcome) -> PoseTuple:
    return max(outcome.hypotheses, key=lambda place: place.probability).pose


def highest(outcome: Outcome) -> float:
    return max(place.probability for place in outcome.hypotheses)


def searches(outcome: Outcome) -> list[str]:
    """Those that begin or end."""
    jobs = (*outcome.begin, *outcome.end)
    return sorted(job for job in jobs if job.startswith("s"))


def test_the_steps_are_those_of_the_log_but_for_the_log_s_rounding(bag: Path) -> None:
    log = steps(recording_or_skip("crob-jarvis/log.clf.gz"))
    own = steps(bag)
    assert len(own) == len(log) == 53
    for ours, theirs in zip(own, log, strict=True):
        assert ours.ranges == theirs.ranges
        assert ours.robot_from_laser == theirs.robot_from_laser
        assert abs(ours.stamp_ns - theirs.stamp_ns) < 600  # of 1e-6 s, and their seconds are floats
        # Six digits, interpolated at the rounded time: 5.6e-7 at most.
        np.testing.assert_allclose(ours.odom_from_robot, theirs.odom_from_robot, atol=1e-6)
        # A LaserScan has its angles as 32 bit numbers.
        assert ours.angle_min_rad == pytest.approx(theirs.angle_min_rad, abs=3e-8)
        assert ours.angle_step_rad == pytest.approx(theirs.angle_step_rad, abs=4e-11)
        assert ours.range_max_m == theirs.range_max_m


def test_the_beliefs_are_those_of_the_log(believed: list[Outcome], cache_folder: Path) -> None:
    log = list(beliefs(recording_or_skip("crob-jarvis/log.clf.gz"), cache_folder))
    assert len(believed) == len(log)
    for ours, theirs in zip(believed, log, strict=True):
        assert (ours.state, searches(ours)) == (theirs.state, searches(theirs))
        if ours.hypotheses:
            # Rounding lets single particles be drawn or not, and places of one point be found
            # or not: 0.0101 m or rad at most,.
            assert highest(ours) == pytest.approx(highest(theirs), abs=0.001)
            np.testing.assert_allclose(best(ours), best(theirs), atol=0.02)
    assert believed[-1].state == "localized"
