import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from clustermcl.belief.dead_reckoning import DeadReckoning
from clustermcl.belief.pose_tracker import LatencyEstimator, PoseTracker
from clustermcl.filter.cluster.gaussian import fit_gaussian
from clustermcl.filter.motion.model import move, standard_normals
from clustermcl.filter.poses import between, compose
from clustermcl.filter.settings import MotionSettings
from clustermcl.protocol.answers import PoseAnswer
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import Scan
from clustermcl.runtime.settings import BridgeSettings, CoordinatorSettings
from tests.unit.coordinator.reports import NO_SPREAD, scan
from tests.unit.evaluation.places import outcome, place
from tests.unit.filter.rooms import PERFECT_ODOMETRY

MS, SECOND = 1_000_000, 1_000_000_000
ORIGIN: PoseTuple = (0.0, 0.0, 0.0)
FACING_NORTH: PoseTuple = (2.0, 3.0, math.pi / 2)
BRIDGE = BridgeSettings(gate_distance_m=0.2, gate_turn_rad=0.2)


def new_tracker(motion: MotionSettings = PERFECT_ODOMETRY) -> PoseTracker:
    settings = CoordinatorSettings(stale_after_s=1.0, dead_reckoning_after_gates=5.0)
    return PoseTracker("coordinator", settings, DeadReckoning(motion, BRIDGE))


def scan_at(stamp_s: float, x_m: float = 0.0, *, live: bool = False) -> Scan:
    return scan(0, live=live, stamp_ns=round(stamp_s * SECOND), x_m=x_m)


def odometry(tracker: PoseTracker, stamp_s: float, x_m: float, *, now_s: float) -> None:
    tracker.odometry(round(stamp_s * SECOND), (x_m, 0.0, 0.0), round(now_s * SECOND))


def answer(tracker: PoseTracker, now_s: float) -> PoseAnswer:
    return tracker.answer(round(now_s * SECOND), workers=1)


def believed_at(
    mean: PoseTuple = ORIGIN,
    odom_from_robot: PoseTuple = ORIGIN,
    motion: MotionSettings = PERFECT_ODOMETRY,
) -> PoseTracker:
    """After a step at one second by the robot's clock, which arrived at 0."""
    tracker = new_tracker(motion)
    best = replace(place(0.9, mean), covariance=NO_SPREAD)
    applied = replace(scan_at(1), odom_from_robot=odom_from_robot)
    tracker.scan(applied, 0)
    tracker.weighed(applied)
    tracker.believed(outcome("localized", best, elsewhere=0.0), odom_from_robot)
    return tracker


def test_the_freshness_is_none_before_any_data() -> None:
    found = new_tracker().answer(5, workers=2)
    assert found.freshness == "none"
    assert found.pose is None
    assert found.age_s == -1.0


def test_the_newest_odometry_carries_the_pose_forward() -> None:
    tracker = believed_at(FACING_NORTH, odom_from_robot=(10.0, 10.0, 0.0))
    tracker.odometry(2 * SECOND, (11.0, 10.0, 0.5), now_ns=SECOND)
    found = answer(tracker, 1)
    assert found.pose == pytest.approx((2.0, 4.0, math.pi / 2 + 0.5))
    assert found.stamp_ns == 2 * SECOND


def test_old_data_is_stale_and_has_its_age() -> None:
    tracker = believed_at(FACING_NORTH)
    assert answer(tracker, 1).freshness == "fresh"
    found = answer(tracker, 3)
    assert found.freshness == "stale"
    assert found.age_s == pytest.approx(3.0)
    for now_s in range(3, 7):
        odometry(tracker, 2, 0.0, now_s=now_s)
    assert answer(tracker, 6).freshness == "stale", "its clock has stopped"


def test_an_older_scan_takes_the_pose_back_only_without_odometry_in_between() -> None:
    tracker = believed_at()
    tracker.scan(scan_at(0.5, 1.0), SECOND)
    assert answer(tracker, 1).pose == pytest.approx((1.0, 0.0, 0.0))
    odometry(tracker, 3, 2.0, now_s=1)
    tracker.scan(scan_at(2, 1.0), 2 * SECOND)
    assert answer(tracker, 2).pose == pytest.approx((2.0, 0.0, 0.0))


@pytest.mark.parametrize(("live", "freshness"), [(True, "stale"), (False, "fresh")])
def test_delayed_data_of_a_live_robot_is_not_fresh(live: bool, freshness: str) -> None:
    tracker = new_tracker()
    tracker.scan(scan_at(100, live=live), 0)
    odometry(tracker, 101, 0.5, now_s=2.3)  # 1.3 s late
    found = answer(tracker, 2.3)
    assert found.freshness == freshness
    assert found.age_s == pytest.approx(1.3 if live else 0.0)


def test_a_recording_after_a_live_robot_does_not_use_its_clock() -> None:
    tracker = new_tracker()
    tracker.scan(scan_at(100, live=True), 0)
    tracker.scan(scan_at(1), SECOND)
    odometry(tracker, 2, 0.5, now_s=10)
    assert tracker.age_s(10 * SECOND) == 0.0


@pytest.mark.parametrize("live", [True, False])
def test_a_successor_receives_whether_the_robot_is_live(live: bool) -> None:
    tracker = new_tracker()
    tracker.resume(scan_at(100, live=live), age_s=0.5, now_ns=0)
    odometry(tracker, 101, 0.5, now_s=1)
    odometry(tracker, 102, 1.0, now_s=3.3)  # 1.3 s late
    assert tracker.age_s(int(3.3 * SECOND)) == pytest.approx(1.3 if live else 0.0)


def test_odometry_alone_makes_the_pose_as_uncertain_as_particles_without_scans_become() -> None:
    motion = MotionSettings(turn_noise_per_turn=0.05, turn_noise_per_metre=0.05)
    tracker = believed_at(FACING_NORTH, odom_from_robot=(5.0, 5.0, 1.0), motion=motion)
    rng = np.random.default_rng(1)
    start = np.array(FACING_NORTH)
    particles = rng.multivariate_normal(start, np.reshape(NO_SPREAD, (3, 3)), 50_000)
    odometry = np.array([5.0, 5.0, 1.0])
    for step in range(1, 41):  # there and, after half a turn, back: in the end it has not moved far
        before = odometry
        turn = np.pi / 8 if 16 <= step < 24 else 0.0
        drive = 0.0 if turn else 0.25
        odometry = compose(before, np.array([drive, 0.0, turn]))
        noise = standard_normals(rng, 3, len(particles))
        particles = move(particles, between(before, odometry), motion, noise)
        x, y, heading = odometry.tolist()
        for now_ns in (0, 1):  # the same once more moves nothing
            tracker.odometry((step + 1) * SECOND + now_ns, (x, y, heading), now_ns=step * SECOND)
    found = answer(tracker, 40)
    assert found.covariance is not None
    expected_mean, expected = fit_gaussian(particles, np.ones(len(particles)))
    assert found.pose is not None
    # First order: where headings err by 0.1 rad, 4 m are up to 2 cm short. 50,000 particles: 0.6 %.
    scale = np.sqrt(np.diag(expected))
    off = np.reshape(found.covariance, (3, 3)) - expected
    np.testing.assert_allclose(off / np.outer(scale, scale), 0.0, atol=0.05)
    assert np.hypot(*(np.array(found.pose) - expected_mean)[:2]) < 0.1 * scale[:2].sum()
    (place,) = tracker.hypotheses()
    assert place.covariance == found.covariance
    assert scale[0] > 2 * 0.1, "the robot has come back, and yet knows little"


def driven_on(tracker: PoseTracker, metres: float) -> None:
    for index in range(1, round(metres / 0.05) + 1):
        tracker.odometry(SECOND + index, (0.05 * index, 0.0, 0.0), now_ns=SECOND)


def test_a_robot_that_drives_on_without_steps_is_dead_reckoning() -> None:
    tracker = believed_at()
    driven_on(tracker, 0.8)
    assert answer(tracker, 1).freshness == "fresh"
    driven_on(tracker, 1.2)
    found = answer(tracker, 1)
    assert found.freshness == "dead_reckoning"
    assert found.scan_age_s == 1.0
    assert found.age_s == 0.0
    tracker.scan(scan_at(2, 1.2), SECOND)
    tracker.weighed(scan_at(2, 1.2))
    assert answer(tracker, 1).freshness == "fresh"
    assert answer(tracker, 1).scan_age_s == 0.0


@pytest.mark.parametrize("turn", [0.05, -0.05])
def test_turning_without_steps_is_dead_reckoning_and_standing_is_not(turn: float) -> None:
    tracker = believed_at()
    for index in range(100):
        tracker.odometry(SECOND + index, (0.001 * (index % 2), 0.0, 0.0), now_ns=SECOND)
    assert answer(tracker, 1).freshness == "fresh"
    for index in range(30):
        tracker.odometry(2 * SECOND + index, (0.0, 0.0, turn * index), now_ns=SECOND)
    assert answer(tracker, 1).freshness == "dead_reckoning"


def test_without_workers_the_pose_is_dead_reckoning_and_without_data_stale() -> None:
    tracker = believed_at()
    assert tracker.answer(SECOND // 2, workers=0).freshness == "dead_reckoning"
    assert tracker.answer(3 * SECOND, workers=0).freshness == "stale"


def test_a_fetched_scan_alone_leaves_the_pose_stale() -> None:
    tracker = new_tracker()
    assert not tracker.is_age_guessed, "nothing has arrived"
    tracker.resume(scan_at(1, live=True), 0.1, now_ns=0)
    assert answer(tracker, 0).scan_age_s == answer(tracker, 0).age_s
    tracker.scan(scan_at(2, 0.1, live=True), 1 * SECOND, fetched=True)
    assert answer(tracker, 1).freshness == "stale"
    assert answer(tracker, 1).stamp_ns == 2 * SECOND, "but it is the newest"
    assert tracker.is_age_guessed
    odometry(tracker, 9, 0.1, now_s=1)
    assert answer(tracker, 1).freshness == "fresh"
    assert not tracker.is_age_guessed


def test_the_age_of_a_scan_follows_from_its_own_stamp() -> None:
    tracker = new_tracker()
    tracker.scan(scan_at(1, live=True), SECOND)
    odometry(tracker, 3, 0.5, now_s=3)
    assert tracker.age_of_s(1 * SECOND, now_ns=4 * SECOND) == 3.0
    assert tracker.age_s(4 * SECOND) == 1.0
    assert new_tracker().age_of_s(1 * SECOND, now_ns=4 * SECOND) == -1.0


def test_fetched_scans_do_not_change_the_usual_delay() -> None:
    tracker = new_tracker()
    tracker.scan(scan_at(100, 3.0, live=True), 100 * SECOND)
    tracker.scan(scan_at(90, 1.0, live=True), 100 * SECOND, fetched=True)
    found = answer(tracker, 100)
    assert found.stamp_ns == 100 * SECOND, "the newest is still the newest"
    assert found.age_s == 0.0
    odometry(tracker, 101, 3.0, now_s=102)
    assert tracker.age_s(102 * SECOND) == 1.0, "it was held up for so long"


def test_a_fetched_scan_of_a_live_robot_uses_the_arrival_of_odometry() -> None:
    tracker = new_tracker()
    odometry(tracker, 100, 0.0, now_s=0)
    tracker.scan(scan_at(101, 0.1, live=True), 2 * SECOND, fetched=True)
    assert tracker.age_s(2 * SECOND) == 1.0, "not the 2 s since the odometry before it"


def test_odometry_with_a_stamp_known_from_another_coordinator_is_as_old_as_its_state() -> None:
    tracker = new_tracker()
    tracker.scan(scan_at(2, 0.1, live=True), 10 * SECOND, fetched=True)
    odometry(tracker, 2, 0.1, now_s=10.1)
    assert answer(tracker, 10.1).age_s == pytest.approx(0.1)


def prompt(clock_ahead_ns: int, seconds: float) -> LatencyEstimator:
    """A robot whose odometry takes 5 ms, 20 times a second."""
    lateness = LatencyEstimator()
    for tick in range(int(seconds * 20)):
        now_ns = tick * 50 * MS
        lateness.on_arrival(now_ns - 5 * MS + clock_ahead_ns, now_ns)
    return lateness


@given(st.integers(-(10**18), 10**18))
def test_delayed_data_is_late_by_the_delay_whatever_the_robots_clock(ahead_ns: int) -> None:
    lateness = prompt(ahead_ns, 30.0)
    assert lateness.on_arrival(30 * SECOND - 5 * MS + ahead_ns, 30 * SECOND) == 0
    assert lateness.on_arrival(30 * SECOND - 5 * MS + ahead_ns, 31 * SECOND) == SECOND


def test_an_outage_of_some_seconds_does_not_change_the_usual_delay() -> None:
    lateness = prompt(0, 30.0)
    assert lateness.on_arrival(30 * SECOND - 5 * MS, 34 * SECOND) == 4 * SECOND
    assert lateness.on_arrival(31 * SECOND - 5 * MS, 34 * SECOND) == 3 * SECOND


def test_the_usual_delay_follows_a_drifting_clock() -> None:
    lateness = LatencyEstimator()
    late_ns = [
        lateness.on_arrival(tick * 50 * MS - tick * 50 * MS // 10_000, tick * 50 * MS)
        for tick in range(20 * 600)
    ]
    assert max(late_ns) <= 2 * MS, "a tenth of a millisecond a second, over at most ten seconds"


@pytest.mark.parametrize("change_ns", [-3600 * SECOND, 7 * SECOND])
def test_a_clock_that_is_set_makes_nothing_late(change_ns: int) -> None:
    lateness = prompt(0, 30.0)
    assert lateness.on_arrival(30 * SECOND + change_ns, 30 * SECOND) == 0
    assert lateness.on_arrival(31 * SECOND + change_ns, 31 * SECOND) == 0


@pytest.mark.parametrize(("gates", "freshness"), [(4.999, "fresh"), (5.0, "dead_reckoning")])
def test_from_the_configured_number_of_gates_on_the_pose_is_dead_reckoning(
    gates: float, freshness: str
) -> None:
    tracker = believed_at()
    tracker.since_step.gates = gates
    assert answer(tracker, 0.5).freshness == freshness
