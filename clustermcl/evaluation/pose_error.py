"""Pose errors; a pose is right within 1 m and 20 degrees of the truth."""

import math
from dataclasses import dataclass

from clustermcl.filter.poses import heading_distance
from clustermcl.protocol.message import PoseTuple

RIGHT_WITHIN_M = 1.0
RIGHT_WITHIN_RAD = math.radians(20.0)
CONFIDENT_PROBABILITY = 0.9


@dataclass(frozen=True, slots=True)
class PoseError:
    """The error of a pose: distance [m] and angle [rad] to the true pose, both non-negative."""

    distance_m: float
    heading_rad: float

    @property
    def heading_deg(self) -> float:
        return math.degrees(self.heading_rad)

    @property
    def right(self) -> bool:
        return self.distance_m <= RIGHT_WITHIN_M and self.heading_rad <= RIGHT_WITHIN_RAD


def pose_error(pose: PoseTuple, truth: PoseTuple) -> PoseError:
    """Return the error of a pose; the heading error is at most pi."""
    return PoseError(math.dist(pose[:2], truth[:2]), float(heading_distance(pose[2], truth[2])))
