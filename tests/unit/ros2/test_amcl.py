from collections.abc import Callable, Iterable
from math import inf, nan, pi
from typing import Any

import numpy as np
import pytest

from clustermcl.filter.poses import compose
from clustermcl.protocol.answers import Relocalize, SetPose
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import LaserReading, MapReading, OdometryReading
from clustermcl.recordings.rigid import Rigid, flat
from clustermcl.ros2 import message_types as types
from clustermcl.ros2 import topics
from clustermcl.ros2.amcl import Amcl
from clustermcl.ros2.messages_in import MOST_SCANS
from clustermcl.ros2.messages_out import header, pose, pose_stamped, transform
from clustermcl.runtime.settings import Ros2Settings
from clustermcl.sensor_bridge.step_maker import beams_of
from tests.ros_messages import decode, link, new
from tests.unit.coordinator.reports import particles
from tests.unit.ros2.ports import COVARIANCE, Kept, Publish, Refused, belief

SECOND = 1_000_000_000
ORIGIN, PLACE = (0.0, 0.0, 0.0), (5.0, -3.0, 1.0)


def scan(
    stamp_ns: int, ranges: Iterable[float] = (1.0, 2.0, 3.0), frame: str = "laser", **more: Any
) -> Any:
    fields = {"angle_min": -0.5, "angle_increment": 0.25, "range_min": 0.1, "range_max": 10.0}
    values = np.array(list(ranges), np.float32)
    fields = {"header": header(stamp_ns, frame), "ranges": values, **fields}
    return new(types.LASER_SCAN, **fields | more)


CELLS = (0, 100, -1, -1, 0, 0)


def grid(
    width: int = 3,
    height: int = 2,
    frame: str = "map",
    *,
    x: float = 0.0,
    cells: tuple[int, ...] = CELLS,
) -> Any:
    origin = pose((x, 0.0, 0.0))
    size = {"width": width, "height": height, "resolution": 0.05}
    info = new("nav_msgs/msg/MapMetaData", origin=origin, **size)
    data = np.array(cells, np.int8)
    return new(types.OCCUPANCY_GRID, header=header(0, frame), info=info, data=data)


class Robot:
    """Passes a robot's messages to a node; each method returns what the node does."""

    def __init__(self, settings: Ros2Settings | None = None, *, active: bool = True) -> None:
        self.kept = Kept()
        self.amcl = Amcl(settings or Ros2Settings(), self.kept, self.kept, "amcl")
        assert not active or self.activate() == []
        assert self.mount("laser", flat((0.2, 0.1, 0.3))) == []

    def done(self, act: Callable[..., None], *arguments: Any, **more: Any) -> list[Any]:
        self.kept.log.clear()
        act(*arguments, **more)
        return [*self.kept.log]

    def activate(self) -> list[Any]:
        return self.done(self.amcl.activate)

    def mount(self, frame: str, at: Rigid) -> list[Any]:
        return self.transforms(link("base_footprint", frame, at), fixed=True)

    def transforms(self, message: Any, *, fixed: bool = False) -> list[Any]:
        return self.done(self.amcl.on_transforms, message, fixed=fixed)

    def odometry(self, stamp_ns: int, at: PoseTuple = ORIGIN) -> list[Any]:
        return self.transforms(transform(at, stamp_ns, "odom", "base_footprint"))

    def scan(self, *arguments: Any, **more: Any) -> list[Any]:
        return self.done(self.amcl.on_scan, scan(*arguments, **more))

    def drive(self, stamp_ns: int, at: PoseTuple = ORIGIN) -> list[Any]:
        return self.odometry(stamp_ns, at) + self.scan(stamp_ns)

    def believe(self, stamp_ns: int, state: Any = "localized") -> list[Any]:
        places = (1, 0.95, PLACE), (2, 0.05, (0.0, 0.0, 0.0))
        outputs = self.done(self.amcl.on_belief, belief(stamp_ns, *places, state=state))
        return outputs + self.done(self.amcl.all_places)

    def give(self, message: Any) -> list[Any]:
        return self.done(self.amcl.on_initial_pose, message)

    def map(self, message: Any) -> list[Any]:
        return self.done(self.amcl.on_map, message)

    def observe(self, message: Any, name: str) -> list[Any]:
        topic = topics.Topic(name, message.__msgtype__, topics.Qos())
        return self.done(self.amcl.on_observed, message, topic)

    def wait(self, now_ns: int) -> list[Any]:
        self.kept.process_ns = now_ns
        return self.done(self.amcl.use_waiting)


def readings(outputs: list[Any]) -> list[LaserReading]:
    return [one for one in outputs if isinstance(one, LaserReading)]


def causes(outputs: list[Any]) -> list[str]:
    return [one.cause for one in outputs if isinstance(one, Refused)]


def published(outputs: list[Any], topic: topics.Topic) -> list[Any]:
    return [one.message for one in outputs if isinstance(one, Publish) and one.topic == topic]


def map_from_odom(outputs: list[Any]) -> list[tuple[int, PoseTuple]]:
    """Stamp and pose of each transform from map to odom."""
    sent = []
    for one in published(outputs, topics.TF):
        reported = one.transforms[0]
        assert (reported.header.frame_id, reported.child_frame_id) == ("map", "odom")
        turn, at = reported.transform.rotation, reported.transform.translation
        stamp_ns = reported.header.stamp.sec * SECOND + reported.header.stamp.nanosec
        sent.append((stamp_ns, (at.x, at.y, 2.0 * float(np.arctan2(turn.z, turn.w)))))
    return sent


# --- scans


def test_a_scan_becomes_a_reading_with_odometry_and_mount_of_its_time() -> None:
    robot = Robot()
    robot.odometry(SECOND)
    assert robot.scan(SECOND + SECOND // 2) == []  # it waits for odometry
    outputs = robot.odometry(2 * SECOND, (1.0, 0.0, 0.2))
    odometry, reading = outputs
    assert isinstance(odometry, OdometryReading)
    assert odometry.stamp_ns == 2 * SECOND
    assert odometry.odom_from_robot == pytest.approx((1.0, 0.0, 0.2))
    assert isinstance(reading, LaserReading)
    assert reading.stamp_ns == SECOND + SECOND // 2
    np.testing.assert_allclose(reading.odom_from_robot or (), (0.5, 0.0, 0.1), atol=1e-12)
    np.testing.assert_allclose(reading.robot_from_laser, (0.2, 0.1, 0.3), atol=1e-12)


def test_ranges_out_of_the_limits_of_laser_and_settings_are_no_return() -> None:
    robot = Robot(Ros2Settings(laser_min_range_m=1.5))
    robot.odometry(SECOND)
    (reading,) = readings(robot.scan(SECOND, (0.05, 1.4, 1.5, 2.0, nan, inf)))
    np.testing.assert_array_equal(beams_of(reading).ranges.array(), [0.0, 0.0, 1.5, 2.0, nan, inf])
    (reading,) = readings(Robot().drive(SECOND))
    np.testing.assert_array_equal(beams_of(reading).ranges.array(), [1.0, 2.0, 3.0])
    for longest_m, expected in ((4.0, 4.0), (40.0, 10.0), (0.0, 10.0), (-1.0, 10.0)):
        (reading,) = readings(Robot(Ros2Settings(laser_max_range_m=longest_m)).drive(SECOND))
        assert reading.range_max_m == expected


@pytest.mark.parametrize(("seconds", "more_ns"), [(-1, 0), (2**31 - 1, 2 * 10**9), (-(2**31), 0)])
def test_times_that_ros_cannot_represent_are_refused_in_every_message(
    seconds: int, more_ns: int
) -> None:
    robot = Robot()
    stamp = new("builtin_interfaces/msg/Time", sec=seconds, nanosec=more_ns)
    at = new("std_msgs/msg/Header", stamp=stamp, frame_id="odom")
    moved = transform(ORIGIN, 0, "odom", "base_footprint")
    moved.transforms[0].header = at
    assert causes(robot.transforms(moved)) == ["transform refused"]
    assert causes(robot.scan(0, header=at)) == ["laser scan refused"]
    assert readings(robot.drive(SECOND))


def test_the_beams_of_an_upside_down_laser_are_reordered() -> None:
    robot = Robot()
    robot.mount("roof", Rigid(0.2, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0))
    robot.odometry(SECOND)
    (reading,) = readings(robot.scan(SECOND, (1.0, 2.0, 3.0), "roof"))
    # Beams at -0.5, -0.25 and 0 rad of the laser are at 0.5, 0.25 and 0 seen from above.
    beams = beams_of(reading)
    assert (beams.angle_min_rad, beams.angle_step_rad) == (0.0, 0.25)
    np.testing.assert_array_equal(beams.ranges.array(), [3.0, 2.0, 1.0])
    np.testing.assert_allclose(reading.robot_from_laser, (0.2, 0.0, 0.0), atol=1e-12)


def test_a_refused_scan_without_transform_names_its_laser_and_delays_no_other() -> None:
    robot = Robot()
    robot.odometry(SECOND)
    assert robot.scan(SECOND, frame="mast") == []
    assert robot.wait(900_000_000) == []
    assert readings(robot.scan(SECOND))
    (refused,) = robot.wait(1_500_000_000)
    assert refused.cause == "laser scan without transform: frames not connected"
    assert refused.detail.startswith("'mast': no transform from 'base_footprint' to 'mast'")


def test_the_oldest_of_too_many_waiting_scans_is_refused() -> None:
    robot = Robot()
    for number in range(MOST_SCANS):
        assert robot.scan(number + 1) == []
    assert causes(robot.scan(99)) == ["laser scan without transform: frames not connected"]


@pytest.mark.parametrize(
    ("fields", "detail"),
    [
        ({"ranges": ()}, "'laser': no beams: 0 beams"),
        ({"angle_increment": 57.3}, "beams, angle step 57.3 rad (degrees?), ranges of 0"),
        ({"ranges": (nan, inf, 0.0)}, "'laser': no returns: 3 beams"),
    ],
)
def test_an_invalid_scan_is_refused_and_the_next_one_used(
    fields: dict[str, Any], detail: str
) -> None:
    robot = Robot()
    robot.odometry(SECOND)
    (refused,) = robot.scan(SECOND, **fields)
    assert refused.cause == "laser scan refused"
    assert detail in refused.detail
    assert len(readings(robot.scan(SECOND))) == 1


# --- odometry


def test_invalid_transforms_are_refused_and_the_others_used() -> None:
    robot = Robot()
    broken = transform((nan, 0.0, 0.0), SECOND, "odom", "base_footprint")
    broken.transforms += transform((1.0, 0.0, 0.0), SECOND, "odom", "base_footprint").transforms
    outputs = robot.transforms(broken)
    assert causes(outputs) == ["transform refused"]
    assert isinstance(outputs[-1], OdometryReading)
    other = transform((1.0, 0.0, 0.0), SECOND, "map", "odom")
    assert causes(robot.transforms(other)) == ["map to odom from another node"]


def test_after_the_clock_was_set_back_transforms_are_accepted_again() -> None:
    robot = Robot()
    robot.drive(100 * SECOND, (1.0, 0.0, 0.0))
    robot.believe(100 * SECOND)
    outputs: list[Any] = []
    for tick in range(25):
        outputs += robot.drive(SECOND + tick * 50_000_000, (1.0, 0.0, 0.0))
    assert causes(outputs).count("clock set back") == 1
    assert len(readings(outputs)) >= 5
    assert map_from_odom(outputs)[-1][0] == SECOND + 24 * 50_000_000 + SECOND


def test_simulated_time_that_goes_back_drops_moving_transforms() -> None:
    robot = Robot()
    robot.drive(100 * SECOND, (1.0, 0.0, 0.0))
    assert causes(robot.done(robot.amcl.on_clock_set_back, 95 * SECOND)) == ["clock set back"]
    assert len(readings(robot.drive(5 * SECOND))) == 1


# --- the pose


def test_a_minute_of_standing_still_has_a_transform_for_every_scan_and_none_jumps() -> None:
    robot = Robot()
    here, there = (1, 0.95, PLACE), (2, 0.05, (-9.0, 4.0, 2.0))
    robot.drive(SECOND, (1.0, 2.0, 0.3))
    robot.amcl.on_belief(belief(SECOND, here, there, state="localized"))
    sent, refused, odometry = [], list[str](), (1.0, 2.0, 0.3)
    for tick in range(1, 601):  # ten scans a second; odometry restarts in the middle
        stamp_ns = SECOND + tick * SECOND // 10
        odometry = ORIGIN if tick >= 300 else odometry
        outputs = robot.drive(stamp_ns, odometry)
        sent += [(one, odometry) for one in map_from_odom(outputs)]
        refused += causes(outputs)
        if tick % 7 == 0:  # now the one, now the other place is more probable: ambiguous
            more, less = (there, here) if tick % 2 else (here, there)
            reported = ((more[0], 0.6, more[2]), (less[0], 0.4, less[2]))
            robot.amcl.on_belief(belief(stamp_ns, *reported))
    assert refused == ["odometry jumped"]
    assert [stamp_ns for (stamp_ns, _), _ in sent] == [
        2 * SECOND + tick * SECOND // 10 for tick in range(1, 601)
    ]
    places = [compose(np.array(reported), np.array(at)) for (_, reported), at in sent]
    np.testing.assert_allclose(places, [PLACE] * len(places), atol=1e-9)


def test_map_to_odom_is_not_published_without_a_place() -> None:
    robot = Robot()
    assert map_from_odom(robot.drive(SECOND)) == []
    assert published(robot.believe(SECOND, "ambiguous"), topics.AMCL_POSE) == []
    assert map_from_odom(robot.drive(2 * SECOND)) == []
    assert published(robot.believe(2 * SECOND), topics.AMCL_POSE) != []
    assert map_from_odom(robot.drive(3 * SECOND)) != []
    robot.amcl.on_belief(belief(3 * SECOND, state="searching"))
    assert map_from_odom(robot.drive(4 * SECOND)) == []


def test_in_a_new_map_the_place_near_the_last_pose_is_held_and_not_the_number() -> None:
    robot = Robot()
    robot.drive(SECOND)
    robot.believe(SECOND)
    robot.amcl.on_new_map()
    found = belief(SECOND, (1, 0.6, (99.0, 0.0, 0.0)), (2, 0.4, PLACE))
    assert len(published(robot.done(robot.amcl.on_belief, found), topics.AMCL_POSE)) == 1
    assert robot.amcl.last_pose == PLACE


def test_a_scan_is_broadcast_once_and_not_without_tf_broadcast() -> None:
    for is_on in (True, False):
        robot = Robot(Ros2Settings(tf_broadcast=is_on))
        robot.drive(SECOND)
        assert published(robot.believe(SECOND), topics.AMCL_POSE) != []
        twice = robot.drive(2 * SECOND) + robot.scan(2 * SECOND)
        assert len(map_from_odom(twice)) == is_on


def test_the_pose_has_the_scans_stamp_and_the_covariance_of_ros() -> None:
    robot = Robot()
    robot.drive(SECOND)
    (reported,) = published(robot.believe(SECOND), topics.AMCL_POSE)
    assert (reported.header.stamp.sec, reported.header.frame_id) == (1, "map")
    wide = np.reshape(reported.pose.covariance, (6, 6))
    np.testing.assert_array_equal(
        wide[np.ix_((0, 1, 5), (0, 1, 5))], np.reshape(COVARIANCE, (3, 3))
    )
    assert np.count_nonzero(wide) == np.count_nonzero(COVARIANCE)


def test_all_places_are_published_with_their_probabilities() -> None:
    robot = Robot()
    robot.drive(SECOND)
    outputs = robot.believe(SECOND, "ambiguous")
    (state,) = published(outputs, topics.STATE)
    (probability,) = published(outputs, topics.PROBABILITY)
    assert (state.data, probability.data) == ("ambiguous", 0.95)
    (reported,) = published(outputs, topics.HYPOTHESIS_DETECTION)
    results = [(one.hypothesis.class_id, one.hypothesis.score) for one in reported.results]
    assert results == [("1", 0.95), ("2", 0.05)]
    given = [one.pose.pose.position for one in reported.results]
    assert [(one.x, one.y) for one in given] == [PLACE[:2], (0.0, 0.0)]
    (drawn,) = published(outputs, topics.HYPOTHESES)
    assert drawn.markers[0].action == 3  # all of before go
    assert [one.ns for one in drawn.markers[1:4]] == ["arrow", "ellipse", "percentage"]
    assert [one.text for one in drawn.markers if one.text] == ["95 %", "5 %"]
    ellipse = drawn.markers[2]
    axes = 4.0 * np.sqrt(np.linalg.eigvalsh(np.reshape(COVARIANCE, (3, 3))[:2, :2]))
    np.testing.assert_allclose((ellipse.scale.y, ellipse.scale.x), axes)


def test_particles_are_moved_by_odometry_and_weighted_by_cluster() -> None:
    robot = Robot()
    robot.drive(SECOND)
    poses = [(1.0, 2.0, 0.0), (9.0, 9.0, 0.0)]
    cloud = particles(poses, (0.0, -np.inf), odom=(-1.0, 0.0, 0.0))
    assert published(robot.believe(SECOND), topics.PARTICLE_CLOUD) == []
    robot.amcl.on_particles(1, cloud)
    (data,) = published(robot.believe(SECOND), topics.PARTICLE_CLOUD)
    reported = decode(data, types.PARTICLE_CLOUD)
    assert len(reported.particles) == 1900
    assert {(one.pose.position.x, one.pose.position.y) for one in reported.particles} == {
        (2.0, 2.0)
    }
    assert sum(one.weight for one in reported.particles) == pytest.approx(1.0)


def test_a_belief_of_an_older_term_is_ignored() -> None:
    robot = Robot()
    robot.drive(SECOND)
    robot.amcl.on_belief(belief(SECOND, (1, 1.0, PLACE), state="localized", term=3))
    robot.amcl.all_places()
    assert robot.believe(SECOND) == []  # of term 1


# --- what is given


def test_a_pose_of_the_past_has_the_odometry_since_then_added() -> None:
    robot = Robot()
    robot.odometry(SECOND)
    robot.odometry(2 * SECOND, (1.0, 0.0, 0.0))
    message = pose_stamped((5.0, 5.0, pi / 2), COVARIANCE, SECOND, "map")
    (given,) = robot.give(message)
    np.testing.assert_allclose(given.pose, (5.0, 6.0, pi / 2), atol=1e-12)
    assert (given.covariance, given.stamp_ns) == (COVARIANCE, 2 * SECOND)
    for no_past_ns in (0, 5 * SECOND):  # it is the current pose
        (given,) = robot.give(pose_stamped(PLACE, COVARIANCE, no_past_ns, "map"))
        np.testing.assert_allclose(given.pose, PLACE, atol=1e-12)


@pytest.mark.parametrize(
    ("frame", "x", "covariance"),
    [
        ("odom", 0.0, COVARIANCE),
        ("", 0.0, COVARIANCE),
        ("map", nan, COVARIANCE),
        ("map", 0.0, (-1.0, *COVARIANCE[1:])),
        ("map", 0.0, (nan, *COVARIANCE[1:])),
    ],
)
def test_an_invalid_initial_pose_is_refused(frame: str, x: float, covariance: Any) -> None:
    message = pose_stamped((x, 0.0, 0.0), covariance, 0, frame)
    assert causes(Robot().give(message)) == ["initial pose refused"]


def test_a_pose_given_while_inactive_is_remembered() -> None:
    robot = Robot(active=False)
    assert robot.observe(pose_stamped(PLACE, COVARIANCE, SECOND, "map"), "gnss") == []
    assert robot.give(pose_stamped(PLACE, COVARIANCE, 0, "map")) == []
    (given,) = robot.activate()
    assert isinstance(given, SetPose)
    robot.amcl.deactivate()
    assert causes(robot.give(pose_stamped(PLACE, COVARIANCE, 0, "odom"))) == [
        "initial pose refused"
    ]
    assert robot.activate() == []


def test_the_initial_pose_of_the_settings_is_given_at_activation() -> None:
    settings = Ros2Settings(set_initial_pose=True, initial_x_m=1.0, initial_heading_rad=0.5)
    (given,) = Robot(settings, active=False).activate()
    assert given.pose == (1.0, 0.0, 0.5)
    assert (given.position_sigma_m, given.covariance) == (0.5, None)


@pytest.mark.parametrize("reset", [False, True])
def test_a_reset_keeps_pose_and_place_unless_always_reset_initial_pose_is_set(reset: bool) -> None:
    robot = Robot(Ros2Settings(always_reset_initial_pose=reset))
    robot.drive(SECOND)
    robot.amcl.deactivate()
    assert robot.drive(2 * SECOND, (1.0, 0.0, 0.0)) == []
    assert robot.believe(SECOND) == []
    robot.amcl.clean_up()
    assert list(map(type, robot.activate())) == ([Relocalize] if reset else [])
    assert map_from_odom(robot.drive(3 * SECOND, (1.0, 0.0, 0.0))) != []


# --- the map


@pytest.mark.parametrize("first_only", [False, True])
def test_a_map_is_returned_once_and_again_when_it_changes(first_only: bool) -> None:
    robot = Robot(Ros2Settings(first_map_only=first_only))
    (given,) = robot.map(grid())
    assert isinstance(given, MapReading)
    np.testing.assert_array_equal(given.occupancy.array(), [[0, 100, -1], [-1, 0, 0]])
    assert given.cell_m == 0.05
    assert robot.map(grid()) == []
    assert len(robot.map(grid(x=1.0))) == (not first_only)
    robot.amcl.clean_up()
    assert len(robot.map(grid(x=1.0))) == 1


def test_an_invalid_map_is_refused_and_the_next_one_used() -> None:
    robot = Robot()
    for bad in (grid(0, 0), grid(4, 2), grid(x=nan), grid(cells=(100,) * 6)):
        assert causes(robot.map(bad)) == ["map refused"]
    assert causes(robot.map(grid(frame="world"))) == ["map of another frame"]
    remark, probable = robot.map(grid(cells=(1, 98, 50, 25, 65, -1)))
    assert remark.cause == "map of probabilities"
    np.testing.assert_array_equal(probable.occupancy.array(), [[0, 100, -1], [0, 100, -1]])
