import math

import numpy as np
import pytest
from msgspec.structs import replace

from coordinator.dead_reckoning import DeadReckoning
from coordinator.pose_tracker import PoseTracker
from particle_filter.gaussian import fit_gaussian
from particle_filter.motion import move
from particle_filter.poses import between, compose
from particle_filter.settings import MotionSettings
from process_runtime.settings import BridgeSettings, CoordinatorSettings
from protocol.message import PoseTuple
from protocol.steps import Scan
from tests.unit.coordinator.reports import NO_SPREAD, scan
from tests.unit.evaluation.places import outcome, place

SECOND = 1_000_000_000
FACING_NORTH: PoseTuple = (2.0, 3.0, math.pi / 2)


BRIDGE = BridgeSettings(gate_distance_m=0.2, gate_turn_rad=0.2)
SURE = MotionSettings(
    turn_noise_per_turn=0.0, turn_noise_per_metre=0.0, drive_noise_per_metre=0.0,
    drive_noise_per_turn=0.0, strafe_noise_per_metre=0.0,
)  # fmt: skip
"""Odometry that never errs."""


def new_tracker(motion: MotionSettings = SURE) -> PoseTracker:
    settings = CoordinatorSettings(stale_after_s=1.0, dead_reckoning_after_gates=5.0)
    return PoseTracker("coordinator", settings, DeadReckoning(motion, BRIDGE))


def scan_at(stamp_ns: int, odom_from_robot: PoseTuple, *, live: bool = False) -> Scan:
    return replace(scan(0, live=live), stamp_ns=stamp_ns, odom_from_robot=odom_from_robot)


def believed_at(
    mean: PoseTuple, odom_from_robot: PoseTuple, motion: MotionSettings = SURE
) -> PoseTracker:
    tracker = new_tracker(motion)
    best = replace(place(0.9, mean), covariance=NO_SPREAD)
    tracker.scan(scan_at(1 * SECOND, odom_from_robot), 0)
    tracker.weighed(scan_at(1 * SECOND, odom_from_robot))
    tracker.believed(outcome("localized", best, elsewhere=0.0), odom_from_robot)
    return tracker


def test_the_freshness_is_none_before_any_data() -> None:
    answer = new_tracker().answer(5, workers=2)
    assert answer.freshness == "none"
    assert answer.pose is None
    assert answer.age_s == -1.0


def test_the_newest_odometry_carries_the_pose_forward() -> None:
    tracker = believed_at(FACING_NORTH, odom_from_robot=(10.0, 10.0, 0.0))
    tracker.odometry(2 * SECOND, (11.0, 10.0, 0.5), now_ns=SECOND)
    answer = tracker.answer(SECOND, workers=1)
    assert answer.pose == pytest.approx((2.0, 4.0, math.pi / 2 + 0.5))
    assert answer.stamp_ns == 2 * SECOND


def test_an_uncertain_heading_adds_uncertainty_across_the_drive() -> None:
    tracker = believed_at((0.0, 0.0, 0.0), odom_from_robot=(0.0, 0.0, 0.0))
    tracker.odometry(2 * SECOND, (2.0, 0.0, 0.0), now_ns=SECOND)
    covariance = tracker.answer(SECOND, workers=1).covariance
    assert covariance is not None
    assert covariance[0] == pytest.approx(0.01)
    assert covariance[4] == pytest.approx(0.01 + 2.0**2 * 0.01)


def test_covariances_are_moved_by_odometry_as_poses_are() -> None:
    """Against a numeric derivative: obliquely, forward and sideways, from an oblique heading."""
    odom_before, odom_after = (4.0, -2.0, 0.3), (5.5, -1.2, 0.9)
    mean: PoseTuple = (2.0, 3.0, 0.7)
    moved = between(np.array(odom_before), np.array(odom_after))
    turned = [compose(np.array([2.0, 3.0, 0.7 + d]), moved) for d in (1e-6, -1e-6)]
    by_heading = (turned[0] - turned[1]) / 2e-6
    expected = 0.01 * (np.diag([1.0, 1.0, 0.0]) + np.outer(by_heading, by_heading))
    tracker = believed_at(mean, odom_from_robot=odom_before)
    tracker.odometry(2 * SECOND, odom_after, now_ns=SECOND)
    covariance = tracker.answer(SECOND, workers=1).covariance
    assert covariance is not None
    np.testing.assert_allclose(np.reshape(covariance, (3, 3)), expected, atol=1e-8)


def test_old_data_is_stale_and_has_its_age() -> None:
    tracker = believed_at(FACING_NORTH, odom_from_robot=(0.0, 0.0, 0.0))
    assert tracker.answer(SECOND, workers=1).freshness == "fresh"
    answer = tracker.answer(3 * SECOND, workers=1)
    assert answer.freshness == "stale"
    assert answer.age_s == pytest.approx(3.0)


def test_a_stopped_clock_makes_the_pose_stale() -> None:
    tracker = believed_at(FACING_NORTH, odom_from_robot=(0.0, 0.0, 0.0))
    for now_s in range(1, 5):
        tracker.odometry(2 * SECOND, (0.0, 0.0, 0.0), now_ns=now_s * SECOND)
    assert tracker.answer(4 * SECOND, workers=1).freshness == "stale"


def test_a_scan_older_than_the_newest_odometry_does_not_take_the_pose_back() -> None:
    tracker = believed_at((0.0, 0.0, 0.0), odom_from_robot=(0.0, 0.0, 0.0))
    tracker.odometry(3 * SECOND, (2.0, 0.0, 0.0), now_ns=SECOND)
    tracker.scan(scan_at(2 * SECOND, (1.0, 0.0, 0.0)), 2 * SECOND)
    answer = tracker.answer(2 * SECOND, workers=1)
    assert answer.pose == pytest.approx((2.0, 0.0, 0.0))


def test_stamps_of_scans_may_step_back_without_odometry_in_between() -> None:
    tracker = believed_at((0.0, 0.0, 0.0), odom_from_robot=(0.0, 0.0, 0.0))
    tracker.scan(scan_at(SECOND // 2, (1.0, 0.0, 0.0)), SECOND)
    assert tracker.answer(SECOND, workers=1).pose == pytest.approx((1.0, 0.0, 0.0))


@pytest.mark.parametrize(("live", "freshness"), [(True, "stale"), (False, "fresh")])
def test_delayed_data_of_a_live_robot_is_not_fresh(live: bool, freshness: str) -> None:
    tracker = new_tracker()
    tracker.scan(scan_at(100 * SECOND, (0.0, 0.0, 0.0), live=live), 0)
    tracker.odometry(101 * SECOND, (0.5, 0.0, 0.0), now_ns=int(2.3 * SECOND))  # 1.3 s late
    answer = tracker.answer(int(2.3 * SECOND), workers=1)
    assert answer.freshness == freshness
    assert answer.age_s == pytest.approx(1.3 if live else 0.0)


def test_the_newest_scan_decides_whether_stamps_show_delays() -> None:
    tracker = new_tracker()
    assert not tracker.live
    for step, live in enumerate((True, True, False, True)):
        tracker.scan(scan_at(step * SECOND, (0.0, 0.0, 0.0), live=live), step * SECOND)
        assert tracker.live == live


def test_a_recording_after_a_live_robot_does_not_use_its_clock() -> None:
    tracker = new_tracker()
    tracker.scan(scan_at(100 * SECOND, (0.0, 0.0, 0.0), live=True), 0)
    tracker.scan(scan_at(SECOND, (0.0, 0.0, 0.0), live=False), SECOND)
    tracker.odometry(2 * SECOND, (0.5, 0.0, 0.0), now_ns=10 * SECOND)
    assert tracker.age_s(10 * SECOND) == 0.0


@pytest.mark.parametrize("live", [True, False])
def test_a_successor_receives_whether_the_robot_is_live(live: bool) -> None:
    tracker = new_tracker()
    tracker.resume(scan_at(100 * SECOND, (0.0, 0.0, 0.0), live=live), age_s=0.5, now_ns=0)
    tracker.odometry(101 * SECOND, (0.5, 0.0, 0.0), now_ns=SECOND)
    tracker.odometry(102 * SECOND, (1.0, 0.0, 0.0), now_ns=int(3.3 * SECOND))  # 1.3 s late
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
        particles = move(particles, between(before, odometry), motion, rng)
        x, y, heading = odometry.tolist()
        for now_ns in (0, 1):  # the same once more moves nothing
            tracker.odometry((step + 1) * SECOND + now_ns, (x, y, heading), now_ns=step * SECOND)
    answer = tracker.answer(40 * SECOND, workers=1)
    assert answer.covariance is not None
    expected_mean, expected = fit_gaussian(particles, np.ones(len(particles)))
    assert answer.pose is not None
    # First order: where headings err by 0.1 rad, 4 m are up to 2 cm short. 50,000 particles: 0.6 %.
    scale = np.sqrt(np.diag(expected))
    off = np.reshape(answer.covariance, (3, 3)) - expected
    np.testing.assert_allclose(off / np.outer(scale, scale), 0.0, atol=0.05)
    assert np.hypot(*(np.array(answer.pose) - expected_mean)[:2]) < 0.1 * scale[:2].sum()
    assert scale[0] > 2 * 0.1, "the robot has come back, and yet knows little"


def test_all_hypotheses_become_as_uncertain_as_the_best_one() -> None:
    tracker = believed_at((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), MotionSettings())
    tracker.odometry(2 * SECOND, (0.5, 0.0, 0.0), now_ns=SECOND)
    (place,) = tracker.hypotheses()
    assert place.covariance == tracker.answer(SECOND, workers=1).covariance
    assert place.covariance[0] > NO_SPREAD[0]


def driven_on(tracker: PoseTracker, metres: float) -> None:
    for index in range(1, round(metres / 0.05) + 1):
        tracker.odometry(SECOND + index, (0.05 * index, 0.0, 0.0), now_ns=SECOND)


def test_a_robot_that_drives_on_without_steps_is_dead_reckoning() -> None:
    tracker = believed_at((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    driven_on(tracker, 0.8)
    assert tracker.answer(SECOND, workers=1).freshness == "fresh"
    driven_on(tracker, 1.2)
    answer = tracker.answer(SECOND, workers=1)
    assert answer.freshness == "dead_reckoning"
    assert answer.scan_age_s == 1.0
    assert answer.age_s == 0.0
    tracker.scan(scan_at(2 * SECOND, (1.2, 0.0, 0.0)), SECOND)
    tracker.weighed(scan_at(2 * SECOND, (1.2, 0.0, 0.0)))
    assert tracker.answer(SECOND, workers=1).freshness == "fresh"
    assert tracker.answer(SECOND, workers=1).scan_age_s == 0.0


def test_turning_without_steps_is_dead_reckoning_and_standing_is_not() -> None:
    tracker = believed_at((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    for index in range(100):
        tracker.odometry(SECOND + index, (0.001 * (index % 2), 0.0, 0.0), now_ns=SECOND)
    assert tracker.answer(SECOND, workers=1).freshness == "fresh"
    for index in range(30):
        tracker.odometry(2 * SECOND + index, (0.0, 0.0, 0.05 * index), now_ns=SECOND)
    assert tracker.answer(SECOND, workers=1).freshness == "dead_reckoning"


def test_without_workers_the_pose_is_dead_reckoning_and_without_data_stale() -> None:
    tracker = believed_at((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    assert tracker.answer(SECOND // 2, workers=0).freshness == "dead_reckoning"
    assert tracker.answer(3 * SECOND, workers=0).freshness == "stale"


def test_a_live_robots_stamps_show_the_age_of_a_fetched_scan() -> None:
    tracker = new_tracker()
    tracker.scan(scan_at(100 * SECOND, (0.0, 0.0, 0.0), live=True), 0)
    tracker.odometry(103 * SECOND, (0.5, 0.0, 0.0), now_ns=3 * SECOND)
    tracker.scan(scan_at(101 * SECOND, (0.2, 0.0, 0.0), live=True), 3 * SECOND)
    assert tracker.answer(3 * SECOND, workers=1).scan_age_s == -1.0
    tracker.weighed(scan_at(101 * SECOND, (0.2, 0.0, 0.0)))
    assert tracker.answer(4 * SECOND, workers=1).scan_age_s == 3.0


def test_after_a_take_over_the_last_scan_is_not_younger_than_the_data() -> None:
    tracker = new_tracker()
    tracker.resume(scan_at(100 * SECOND, (0.0, 0.0, 0.0)), age_s=0.5, now_ns=0)
    answer = tracker.answer(0, workers=1)
    assert answer.scan_age_s == answer.age_s


def test_a_fetched_scan_alone_leaves_the_pose_stale() -> None:
    tracker = new_tracker()
    tracker.resume(scan_at(1 * SECOND, (0.0, 0.0, 0.0), live=True), 0.1, now_ns=0)
    tracker.scan(scan_at(2 * SECOND, (0.1, 0.0, 0.0), live=True), 1 * SECOND, fetched=True)
    assert tracker.answer(1 * SECOND, workers=1).freshness == "stale"
    assert tracker.answer(1 * SECOND, workers=1).stamp_ns == 2 * SECOND, "but it is the newest"
    tracker.odometry(9 * SECOND, (0.1, 0.0, 0.0), 1 * SECOND)
    assert tracker.answer(1 * SECOND, workers=1).freshness == "fresh"


def test_a_successor_with_a_usual_delay_has_the_age_of_the_last_scan() -> None:
    tracker = new_tracker()
    tracker.begin(usual_delay_ns=-99 * SECOND, now_ns=3 * SECOND)
    tracker.resume(scan_at(100 * SECOND, (0.0, 0.0, 0.0), live=True), 0.0, now_ns=int(3.3 * SECOND))
    answer = tracker.answer(int(3.3 * SECOND), workers=1)
    assert answer.age_s == answer.scan_age_s == pytest.approx(2.3)
    assert answer.freshness == "stale"
    tracker.odometry(102 * SECOND, (0.5, 0.0, 0.0), now_ns=int(3.3 * SECOND))
    assert tracker.age_s(int(3.3 * SECOND)) == pytest.approx(0.3), "held up by the network"


def test_the_age_of_a_scan_follows_from_its_own_stamp() -> None:
    tracker = new_tracker()
    tracker.scan(scan_at(1 * SECOND, (0.0, 0.0, 0.0), live=True), SECOND)
    tracker.odometry(3 * SECOND, (0.5, 0.0, 0.0), now_ns=3 * SECOND)
    assert tracker.age_of_s(1 * SECOND, now_ns=4 * SECOND) == 3.0
    assert tracker.age_s(4 * SECOND) == 1.0
    assert new_tracker().age_of_s(1 * SECOND, now_ns=4 * SECOND) == -1.0


def test_fetched_scans_do_not_change_the_usual_delay() -> None:
    tracker = new_tracker()
    tracker.scan(scan_at(100 * SECOND, (3.0, 0.0, 0.0), live=True), 100 * SECOND)
    tracker.scan(scan_at(90 * SECOND, (1.0, 0.0, 0.0), live=True), 100 * SECOND, fetched=True)
    answer = tracker.answer(100 * SECOND, workers=1)
    assert answer.stamp_ns == 100 * SECOND, "the newest is still the newest"
    assert answer.age_s == 0.0
    tracker.odometry(101 * SECOND, (3.0, 0.0, 0.0), now_ns=102 * SECOND)
    assert tracker.age_s(102 * SECOND) == 1.0, "it was held up for so long"


def test_a_fetched_scan_of_a_live_robot_uses_the_arrival_of_odometry() -> None:
    tracker = new_tracker()
    tracker.odometry(100 * SECOND, (0.0, 0.0, 0.0), now_ns=0)
    tracker.scan(scan_at(101 * SECOND, (0.1, 0.0, 0.0), live=True), 2 * SECOND, fetched=True)
    assert tracker.age_s(2 * SECOND) == 1.0, "not the 2 s since the odometry before it"


def test_odometry_with_a_stamp_known_from_another_coordinator_is_as_old_as_its_state() -> None:
    tracker = new_tracker()
    scan_ns, arrived_ns = 10 * SECOND, 10 * SECOND + SECOND // 10
    tracker.scan(scan_at(2 * SECOND, (0.1, 0.0, 0.0), live=True), scan_ns, fetched=True)
    tracker.odometry(2 * SECOND, (0.1, 0.0, 0.0), arrived_ns)
    assert tracker.age_s(arrived_ns) == pytest.approx(0.1)
