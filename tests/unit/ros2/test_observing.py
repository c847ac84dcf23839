import math
from math import inf, nan
from typing import Any

import numpy as np
import pytest

from clustermcl.protocol.errors import SettingsError
from clustermcl.protocol.steps import Observation
from clustermcl.recordings.rigid import Rigid, flat
from clustermcl.ros2 import message_types as types
from clustermcl.ros2.amcl import Amcl
from clustermcl.ros2.messages_out import header, transform
from clustermcl.ros2.observing import MAX_WAITING
from clustermcl.ros2.outputs import Output, Refused
from clustermcl.runtime.settings import Ros2Settings
from tests.ros_messages import new
from tests.unit.ros2.test_amcl import SECOND, Robot, causes, observe

OPTICAL = Rigid(0.2, 0.0, 0.5, -0.5, 0.5, -0.5, 0.5)
"""Pose of a camera that looks ahead: its z axis is the robot's x axis."""
NORTHWARD = Ros2Settings(gnss_topics="fix", datum="52.0, 4.0, 90")


def fix(
    latitude: float = 52.0, longitude: float = 4.0, *, status: int = 0, known: int = 2,
    covariance: tuple[float, ...] = (4.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 9.0),
) -> Any:  # fmt: skip
    return new(
        types.NAV_SAT_FIX,
        header=header(SECOND, "antenna"),
        status=new("sensor_msgs/msg/NavSatStatus", status=status),
        latitude=latitude,
        longitude=longitude,
        position_covariance=np.array(covariance),
        position_covariance_type=known,
    )


def seen(outputs: list[Output]) -> list[Observation]:
    return [one for one in outputs if isinstance(one, Observation)]


def test_a_minute_of_arc_is_a_nautical_mile_and_the_map_may_be_turned() -> None:
    amcl = Robot(NORTHWARD).amcl
    north, east = (
        seen(list(observe(amcl, fix(*at), "fix")))[0]
        for at in ((52.0 + 1 / 60, 4.0), (52.0, 4.0 + 1 / 60))
    )
    # Published lengths at 52 degrees: 1,854.4 m of latitude, 1,144.5 m of longitude.
    np.testing.assert_allclose(north.mean, (1854.4, 0.0), atol=0.5)
    np.testing.assert_allclose(east.mean, (0.0, -1144.5), atol=0.6)
    np.testing.assert_allclose(north.covariance, (1.0, 0.0, 0.0, 4.0), atol=1e-12)
    assert (north.sender, north.landmark, north.stamp_ns) == ("fix", "", SECOND)


def test_the_antenna_s_distance_from_the_base_adds_to_the_error() -> None:
    robot = Robot(NORTHWARD)
    robot.mount("antenna", flat((-3.0, 4.0, 0.0)))
    (one,) = seen(list(observe(robot.amcl, fix(), "fix")))
    np.testing.assert_allclose(one.covariance, (26.0, 0.0, 0.0, 29.0), atol=1e-12)


@pytest.mark.parametrize(
    ("message", "problem"),
    [
        (fix(status=-1), "it is no fix"),
        (fix(known=0), "its covariance is unknown"),
        (fix(nan), "it is not on Earth"),
        (fix(91.0), "it is not on Earth"),
        (fix(longitude=inf), "it is not on Earth"),
        (fix(covariance=(nan,) * 9), "not all numbers are finite"),
        (fix(covariance=(0.0,) * 9), "a covariance that is not positive definite"),
    ],
)
def test_a_fix_that_cannot_be_used_is_refused(message: Any, problem: str) -> None:
    (refused,) = observe(Robot(NORTHWARD).amcl, message, "fix")
    assert isinstance(refused, Refused)
    assert refused.cause == "observation refused"
    assert refused.detail == f"fix: {problem}"


@pytest.mark.parametrize(
    "datum", ["", "52", "52, 4", "a, b, c", "91, 4, 0", "52, 200, 0", "nan,0,0"]
)
def test_satellite_fixes_need_a_valid_datum(datum: str) -> None:
    with pytest.raises(SettingsError, match="latitude, longitude, direction"):
        Amcl(Ros2Settings(gnss_topics="fix", datum=datum))


def tags(*numbers: int, stamp_ns: int = SECOND) -> Any:
    found = [
        new("apriltag_msgs/msg/AprilTagDetection", family="tag36h11", id=number)
        for number in numbers
    ]
    return new(types.APRIL_TAGS, header=header(stamp_ns, "camera"), detections=found)


def with_camera() -> Robot:
    robot = Robot(Ros2Settings(tag_topics="tags"))
    robot.mount("camera", OPTICAL)
    return robot


def test_a_tag_is_a_landmark_with_the_name_of_its_frame_once_tf_has_it() -> None:
    robot = with_camera()
    assert list(observe(robot.amcl, tags(7), "tags")) == []
    in_camera = transform((-0.5, 0.1, 0.0), SECOND, "camera", "tag36h11:7")
    in_camera.transforms[0].transform.translation.z = 3.0
    (one,) = seen(robot.transforms(in_camera))
    assert (one.sender, one.landmark, one.stamp_ns) == ("tags", "tag36h11:7", SECOND)
    np.testing.assert_allclose(one.mean, (3.2, 0.5), atol=1e-12)
    sigma = 0.05 * math.hypot(3.2, 0.5, 0.4)
    np.testing.assert_allclose(one.covariance, np.diag([sigma**2] * 2).ravel())
    assert list(robot.amcl.on_tick(9 * SECOND)) == []


def test_a_tag_without_transform_is_refused_and_a_flood_is_bounded() -> None:
    robot = with_camera()
    assert list(observe(robot.amcl, tags(7), "tags")) == []
    assert causes(list(robot.amcl.on_tick(2 * SECOND))) == [
        "observation without transform: frames not connected"
    ]
    flood = list(observe(robot.amcl, tags(*range(MAX_WAITING + 5)), "tags"))
    assert causes(flood) == ["observation without transform: too many wait"] * 5
    robot.amcl.deactivate()
    assert list(robot.amcl.on_tick(9 * SECOND)) == []
    (refused,) = observe(with_camera().amcl, tags(7, stamp_ns=0), "tags")
    assert refused == Refused("observation refused", "tags: it has no stamp")


def detected(*results: tuple[str, float], covariance: Any = None, x: float = -0.5) -> Any:
    covariance = np.zeros((6, 6)) if covariance is None else covariance
    given = new("geometry_msgs/msg/PoseWithCovariance", covariance=covariance.ravel())
    given.pose.position.x, given.pose.position.z = x, 3.0
    hypotheses = [
        new(
            "vision_msgs/msg/ObjectHypothesisWithPose",
            hypothesis=new("vision_msgs/msg/ObjectHypothesis", class_id=name, score=score),
            pose=given,
        )
        for name, score in results
    ]
    one = new(types.DETECTION, header=header(SECOND, ""), results=hypotheses)
    return new(types.DETECTIONS, header=header(SECOND, "camera"), detections=[one])


def test_a_detected_object_is_a_landmark_of_its_likeliest_class() -> None:
    amcl = with_camera().amcl
    message = detected(("pillar", 0.3), ("door", 0.6))
    (one,) = seen(list(observe(amcl, message, "objects")))
    assert (one.sender, one.landmark) == ("objects", "door")
    np.testing.assert_allclose(one.mean, (3.2, 0.5), atol=1e-12)
    spread = np.diag([0.01, 0.04, 0.09, 0.0, 0.0, 0.0])  # across, down, ahead of the camera
    (one,) = seen(list(observe(amcl, detected(("door", 0.6), covariance=spread), "o")))
    np.testing.assert_allclose(one.covariance, (0.09, 0.0, 0.0, 0.01), atol=1e-12)


def test_an_object_without_a_class_or_place_is_not_used() -> None:
    amcl = with_camera().amcl
    assert list(observe(amcl, detected(), "objects")) == []
    assert list(observe(amcl, detected(("", 1.0)), "objects")) == []
    (refused,) = observe(amcl, detected(("door", 1.0), x=nan), "objects")
    assert refused == Refused("observation refused", "objects: not all numbers are finite")
