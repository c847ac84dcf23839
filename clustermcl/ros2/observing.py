"""Observations of other sensors in ROS: poses, satellite fixes, and detected tags and objects."""

import math
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clustermcl.protocol.errors import SettingsError
from clustermcl.protocol.message import MAX_ID_CHARACTERS
from clustermcl.protocol.reading_checks import observation_problem
from clustermcl.protocol.steps import Observation
from clustermcl.recordings.headers import frame_name, time_of
from clustermcl.recordings.rigid import IDENTITY, Rigid
from clustermcl.recordings.transforms import TransformMissingError, TransformTree
from clustermcl.ros2 import message_types as types
from clustermcl.ros2.initial_pose import pose_in_map
from clustermcl.ros2.topics import Topic
from clustermcl.runtime.settings import Ros2Settings

MAX_WAITING = 100
"""Limit for the observations of one topic that wait for tf."""
_KNOWN_RAD = math.pi / 2.0
"""An observation with a larger standard deviation of its heading is used without it."""
_LEAST_SIGMA_M = 0.02
_EQUATOR_M, _SQUARED_ECCENTRICITY = 6378137.0, 6.69437999014e-3
"""The ellipsoid WGS 84: equatorial radius [m], and squared eccentricity."""


class Datum:
    """Where the map lies on Earth.

    Attributes:
        map_from_east_north: (2, 2) rotation.

    Raises:
        SettingsError: the setting is not three numbers in their ranges.
    """

    def __init__(self, setting: str) -> None:
        try:
            latitude, longitude, direction = map(float, setting.split(","))
        except ValueError:
            latitude = longitude = direction = math.nan
        if not (abs(latitude) < 90.0 and abs(longitude) <= 180.0 and abs(direction) <= 360.0):
            problem = f"ros2.datum = {setting!r}: expected latitude, longitude, direction"
            raise SettingsError(key="ros2.datum", problem=f"{problem} of the x axis, in degrees")
        angle, lat, lon = map(math.radians, (direction, latitude, longitude))
        sin, cos = math.sin(lat), math.cos(lat)
        east = (-math.sin(lon), math.cos(lon), 0.0)
        north = (-sin * math.cos(lon), -sin * math.sin(lon), cos)
        turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
        self._origin, self.map_from_east_north = _from_centre(latitude, longitude), turn
        self._map_from_earth = turn @ np.array((east, north))

    def in_map(self, latitude_deg: float, longitude_deg: float) -> NDArray[np.float64]:
        """Return the (2,) position in the map of a point at the height of the ellipsoid."""
        at = _from_centre(latitude_deg, longitude_deg)
        return np.asarray(self._map_from_earth @ (at - self._origin))


def _from_centre(latitude_deg: float, longitude_deg: float) -> NDArray[np.float64]:
    """Return the (3,) vector from the centre of the Earth [m]."""
    latitude, longitude = math.radians(latitude_deg), math.radians(longitude_deg)
    sin, cos = math.sin(latitude), math.cos(latitude)
    to_axis = _EQUATOR_M / math.sqrt(1.0 - _SQUARED_ECCENTRICITY * sin**2)
    x, y = cos * math.cos(longitude), cos * math.sin(longitude)
    return to_axis * np.array([x, y, (1.0 - _SQUARED_ECCENTRICITY) * sin])


class Observing:
    """Converts messages of other sensors to observations.

    Raises:
        SettingsError: the datum is not valid.
    """

    def __init__(self, frames: TransformTree, settings: Ros2Settings) -> None:
        self.settings, self._frames = settings, frames
        has_receiver = settings.gnss_topics or settings.datum
        self._datum = Datum(settings.datum) if has_receiver else None

    def conversions(self, message: Any, of: Topic) -> Iterator[Callable[[], Observation]]:
        """Yield a function for each observation in a message; its topic is the source.

        The functions raise a `TransformMissingError` if a transform of the time is missing, and a
        `ValueError` if the message has no stamp, a wrong frame, or numbers that are not valid.
        """
        topic = of.name
        match of.ros_type:
            case types.POSE_STAMPED:
                yield partial(self._pose, message, topic)
            case types.NAV_SAT_FIX:
                yield partial(self._fix, message, topic)
            case types.APRIL_TAGS:
                for tag in message.detections:
                    name = f"{tag.family}:{tag.id}"  # of its frame, too
                    yield partial(self._landmark, message, topic, name, name)
            case types.DETECTIONS:
                for found in message.detections:
                    if any(result.hypothesis.class_id for result in found.results):
                        yield partial(self._object, message, topic, found)

    def _pose(self, message: Any, topic: str) -> Observation:
        pose, covariance = pose_in_map(message, self.settings)
        known = 3 if 0.0 < covariance[2, 2] <= _KNOWN_RAD**2 else 2
        return _checked(message, topic, "", pose[:known], covariance[:known, :known])

    def _fix(self, message: Any, topic: str) -> Observation:
        """Return the position of a `sensor_msgs/NavSatFix`.

        The robot's heading is unknown, so the antenna's distance from the base adds to the error.
        """
        if self._datum is None or message.status.status < 0:
            raise ValueError("it is no fix")
        if message.position_covariance_type == 0:
            raise ValueError("its covariance is unknown")
        if not (abs(message.latitude) <= 90.0 and abs(message.longitude) <= 180.0):
            raise ValueError("it is not on Earth")
        turn, offset = self._datum.map_from_east_north, IDENTITY
        with suppress(TransformMissingError):
            antenna = frame_name(message.header.frame_id)
            offset = self._frames.lookup(self.settings.base_frame, antenna, _stamp_of(message))
        mean = self._datum.in_map(message.latitude, message.longitude)
        covariance = np.reshape(message.position_covariance, (3, 3))[:2, :2]
        wide = turn @ covariance @ turn.T + (offset.x**2 + offset.y**2) * np.eye(2)
        return _checked(message, topic, "", mean, wide)

    def _object(self, message: Any, topic: str, found: Any) -> Observation:
        """Return the position of a `vision_msgs/Detection3D` with its likeliest class."""
        named = [result for result in found.results if result.hypothesis.class_id]
        best = max(named, key=lambda result: float(result.hypothesis.score))
        frame = frame_name(found.header.frame_id or message.header.frame_id)
        given = np.reshape(best.pose.covariance, (6, 6))[:3, :3]
        at, name = best.pose.pose.position, best.hypothesis.class_id
        place = IDENTITY._replace(x=at.x, y=at.y, z=at.z)
        return self._landmark(message, topic, name, frame, place, given if given.any() else None)

    def _landmark(
        self,
        message: Any,
        topic: str,
        name: str,
        frame: str,
        place: Rigid = IDENTITY,
        covariance: NDArray[np.float64] | None = None,
    ) -> Observation:
        """Return the position of a landmark, which a detection puts at `place` in its frame.

        The (3, 3) covariance is of the position in the frame; None: unknown.
        """
        base, stamp_ns = self.settings.base_frame, _stamp_of(message)
        base_from_frame = self._frames.lookup(base, frame, stamp_ns)
        at = base_from_frame.of(place)[:3]
        if covariance is None:
            sigma_m = max(self.settings.sight_sigma_per_m * math.hypot(*at), _LEAST_SIGMA_M)
            covariance = sigma_m**2 * np.eye(3)
        else:
            turn = base_from_frame.rotation()
            covariance = turn @ covariance @ turn.T
        return _checked(message, topic, name, np.array(at[:2]), covariance[:2, :2])


def _stamp_of(message: Any) -> int:
    stamp_ns = time_of(message.header.stamp)
    if stamp_ns == 0:
        raise ValueError("it has no stamp")
    return stamp_ns


def _checked(message: Any, topic: str, name: str, mean: Any, covariance: Any) -> Observation:
    """Return an observation; a ValueError says what is missing or not valid in it."""
    seen = Observation(
        sender=topic[-MAX_ID_CHARACTERS:],
        stamp_ns=_stamp_of(message),
        landmark=name[:MAX_ID_CHARACTERS],
        mean=tuple(mean.tolist()),
        covariance=tuple(covariance.ravel().tolist()),
    )
    if not all(map(math.isfinite, (*seen.mean, *seen.covariance))):
        raise ValueError("not all numbers are finite")
    if problem := observation_problem(seen):
        raise ValueError(problem)
    return seen
