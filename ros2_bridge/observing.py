"""Observations of other sensors in ROS: poses, satellite fixes, and detected tags and objects."""

import math
from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from process_runtime.ros2_settings import Ros2Settings
from protocol.errors import SettingsError
from protocol.message import MAX_ID_CHARACTERS
from protocol.reading_checks import observation_problem
from protocol.steps import Observation
from recordings.headers import frame_name, stamp_of
from recordings.rigid import IDENTITY, Rigid
from recordings.transforms import TransformMissingError, TransformTree
from ros2_bridge import message_types as types
from ros2_bridge.initial_pose import pose_in_map
from ros2_bridge.outputs import Refused

MAX_WAITING = 100
"""Largest number of detections that wait for tf."""
_KNOWN_RAD = math.pi / 2.0
"""An observation with a larger standard deviation of its heading is used without it."""
_LEAST_SIGMA_M = 0.02
_EQUATOR_M, _SQUARED_ECCENTRICITY = 6378137.0, 6.69437999014e-3
"""The ellipsoid WGS 84: equatorial radius [m], and squared eccentricity."""


@dataclass(frozen=True)
class Datum:
    """Where the map lies on Earth."""

    latitude_deg: float
    """Latitude of the map's origin."""
    longitude_deg: float
    direction_deg: float
    """Direction of the map's x axis, counter-clockwise from east."""

    @classmethod
    def of(cls, settings: Ros2Settings) -> "Datum | None":
        """Return the datum of the settings; None: no satellite receiver is used.

        Raises:
            SettingsError: the setting is not three numbers in their ranges.
        """
        if not (settings.gnss_topics or settings.datum):
            return None
        try:
            latitude, longitude, direction = map(float, settings.datum.split(","))
        except ValueError:
            latitude = longitude = direction = math.nan
        if not (abs(latitude) < 90.0 and abs(longitude) <= 180.0 and abs(direction) <= 360.0):
            problem = f"ros2.datum = {settings.datum!r}: expected latitude, longitude, direction"
            raise SettingsError(key="ros2.datum", problem=f"{problem} of the x axis, in degrees")
        return cls(latitude, longitude, direction)

    def map_from_east_north(self) -> NDArray[np.float64]:
        """Return the (2, 2) rotation."""
        angle = math.radians(self.direction_deg)
        cos, sin = math.cos(angle), math.sin(angle)
        return np.array([[cos, sin], [-sin, cos]])

    def in_map(self, latitude_deg: float, longitude_deg: float) -> NDArray[np.float64]:
        """Return the (2,) position in the map of a point at the height of the ellipsoid."""
        latitude, longitude = math.radians(self.latitude_deg), math.radians(self.longitude_deg)
        x, y, z = _from_centre(latitude_deg, longitude_deg) - _from_centre(
            self.latitude_deg, self.longitude_deg
        )
        outward = math.cos(longitude) * x + math.sin(longitude) * y
        east = math.cos(longitude) * y - math.sin(longitude) * x
        north = math.cos(latitude) * z - math.sin(latitude) * outward
        return np.asarray(self.map_from_east_north() @ [east, north])


def _from_centre(latitude_deg: float, longitude_deg: float) -> NDArray[np.float64]:
    """Return the (3,) vector from the centre of the Earth [m]."""
    latitude, longitude = math.radians(latitude_deg), math.radians(longitude_deg)
    sin, cos = math.sin(latitude), math.cos(latitude)
    to_axis = _EQUATOR_M / math.sqrt(1.0 - _SQUARED_ECCENTRICITY * sin**2)
    across = to_axis * cos
    up = to_axis * (1.0 - _SQUARED_ECCENTRICITY) * sin
    return np.array([across * math.cos(longitude), across * math.sin(longitude), up])


@dataclass(frozen=True)
class _Detection:
    """A detected landmark that waits for tf."""

    topic: str
    name: str
    frame: str
    stamp_ns: int
    since_ns: int
    place: Rigid = IDENTITY
    """The landmark's pose in the frame."""
    covariance: NDArray[np.float64] | None = None
    """(3, 3) of the position in the frame; None: unknown."""


class Observing:
    """Converts messages of other sensors to observations, once their transforms are known.

    Raises:
        SettingsError: the datum is not valid.
    """

    def __init__(self, frames: TransformTree, settings: Ros2Settings) -> None:
        self.settings, self._frames = settings, frames
        self._datum = Datum.of(settings)
        self._waiting: deque[_Detection] = deque()

    def clear(self) -> None:
        self._waiting.clear()

    def add(self, message: Any, topic: str, now_ns: int) -> Iterator[Observation | Refused]:
        """Process a message; its topic is the source. Detections wait for `ready`.

        Raises:
            ValueError: the message has no stamp, a wrong frame, or numbers that are not valid.
        """
        stamp_ns = stamp_of(message.header)
        if stamp_ns == 0:
            raise ValueError("it has no stamp")
        match message.__msgtype__:
            case types.POSE_STAMPED:
                pose, covariance = pose_in_map(message, self.settings)
                known = 3 if 0.0 < covariance[2, 2] <= _KNOWN_RAD**2 else 2
                yield _checked(topic, stamp_ns, "", pose[:known], covariance[:known, :known])
            case types.NAV_SAT_FIX:
                mean, covariance = self._fix(message, stamp_ns)
                yield _checked(topic, stamp_ns, "", mean, covariance)
            case types.APRIL_TAGS:
                for tag in message.detections:
                    name = f"{tag.family}:{tag.id}"
                    self._waiting.append(_Detection(topic, name, name, stamp_ns, now_ns))
            case types.DETECTIONS:
                self._waiting.extend(_objects(message, topic, stamp_ns, now_ns))
        while len(self._waiting) > MAX_WAITING:
            yield Refused("too many detections wait for tf", self._waiting.popleft().name)

    def ready(self, now_ns: int) -> Iterator[Observation | Refused]:
        """Remove and yield the detections whose transforms are known, and refuse late ones."""
        waiting, self._waiting = self._waiting, deque()
        for detection in waiting:
            try:
                yield self._seen(detection)
            except TransformMissingError as missing:
                tolerance_ns = self.settings.transform_tolerance_s * 1e9
                if missing.may_come and now_ns - detection.since_ns < tolerance_ns:
                    self._waiting.append(detection)
                else:
                    yield Refused(f"detection without transform: {missing.cause}", str(missing))
            except ValueError as problem:
                yield Refused("detection refused", f"{detection.topic}: {problem}")

    def _fix(self, message: Any, stamp_ns: int) -> tuple[Any, Any]:
        """Return the (2,) position and (2, 2) covariance of a `sensor_msgs/NavSatFix`.

        The robot's heading is unknown, so the antenna's distance from the base adds to the error.
        """
        if self._datum is None or message.status.status < 0:
            raise ValueError("it is no fix")
        if message.position_covariance_type == 0:
            raise ValueError("its covariance is unknown")
        if not (abs(message.latitude) <= 90.0 and abs(message.longitude) <= 180.0):
            raise ValueError("it is not on Earth")
        turn, offset = self._datum.map_from_east_north(), IDENTITY
        with suppress(TransformMissingError):
            antenna = frame_name(message.header.frame_id)
            offset = self._frames.lookup(self.settings.base_frame, antenna, stamp_ns)
        mean = self._datum.in_map(message.latitude, message.longitude)
        covariance = np.reshape(message.position_covariance, (3, 3))[:2, :2]
        return mean, turn @ covariance @ turn.T + (offset.x**2 + offset.y**2) * np.eye(2)

    def _seen(self, detection: _Detection) -> Observation:
        """Return the observation of a detection.

        Raises:
            TransformMissingError: a transform is missing at its time.
            ValueError: its numbers are not valid.
        """
        frame = self._frames.lookup(self.settings.base_frame, detection.frame, detection.stamp_ns)
        place = frame.of(detection.place)
        distance_m = math.hypot(*place[:3])
        sigma_m = max(self.settings.sight_sigma_per_m * distance_m, _LEAST_SIGMA_M)
        covariance = sigma_m**2 * np.eye(2)
        if detection.covariance is not None:
            turn = frame.rotation()
            covariance = (turn @ detection.covariance @ turn.T)[:2, :2]
        return _checked(
            detection.topic, detection.stamp_ns, detection.name, np.array(place[:2]), covariance
        )


def _objects(message: Any, topic: str, stamp_ns: int, now_ns: int) -> Iterator[_Detection]:
    """Yield the objects of a `vision_msgs/Detection3DArray`, each with its likeliest class."""
    for found in message.detections:
        named = [result for result in found.results if result.hypothesis.class_id]
        if not named:
            continue
        best = max(named, key=lambda result: float(result.hypothesis.score))
        frame = frame_name(found.header.frame_id or message.header.frame_id)
        given = np.reshape(best.pose.covariance, (6, 6))[:3, :3]
        at = best.pose.pose.position
        place = IDENTITY._replace(x=at.x, y=at.y, z=at.z)
        covariance = given if given.any() else None
        name = best.hypothesis.class_id
        yield _Detection(topic, name, frame, stamp_ns, now_ns, place, covariance)


def _checked(topic: str, stamp_ns: int, name: str, mean: Any, covariance: Any) -> Observation:
    """Return an observation.

    Raises:
        ValueError: its numbers are not valid.
    """
    seen = Observation(
        sender=topic[-MAX_ID_CHARACTERS:],
        stamp_ns=stamp_ns,
        landmark=name[:MAX_ID_CHARACTERS],
        mean=tuple(mean.tolist()),
        covariance=tuple(covariance.ravel().tolist()),
    )
    if not all(map(math.isfinite, (*seen.mean, *seen.covariance))):
        raise ValueError("not all numbers are finite")
    if problem := observation_problem(seen):
        raise ValueError(problem)
    return seen
