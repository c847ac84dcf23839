"""Whether a pose is right: within 1 m and 20 degrees of the truth."""

import math
from dataclasses import dataclass

from particle_filter.poses import heading_distance
from protocol.message import PoseTuple

RIGHT_WITHIN_M = 1.0
RIGHT_WITHIN_RAD = math.radians(20.0)
CONFIDENT_PROBABILITY = 0.9


@dataclass(frozen=True, slots=True)
class PoseError:
    """How far a pose is from the truth; neither number is negative."""

    distance_m: float
    heading_rad: float

    @property
    def heading_deg(self) -> float:
        """The angle in degrees."""
        return math.degrees(self.heading_rad)

    @property
    def right(self) -> bool:
        """Whether that is near enough."""
        return self.distance_m <= RIGHT_WITHIN_M and self.heading_rad <= RIGHT_WITHIN_RAD


def pose_error(pose: PoseTuple, truth: PoseTuple) -> PoseError:
    """The distance of two poses, the heading the short way round."""
    return PoseError(math.dist(pose[:2], truth[:2]), float(heading_distance(pose[2], truth[2])))
