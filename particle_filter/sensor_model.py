"""One way to weigh poses by a scan, whichever sensor model the settings name."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from particle_filter.arrays import LogWeights, Points, Pose, Poses
from particle_filter.ground import ground_log_penalty
from particle_filter.likelihood_field import LikelihoodField, scan_log_likelihood
from particle_filter.ray_casting import JumpField
from particle_filter.scan_points import points_in_robot, usable_beams
from particle_filter.settings import SensorSettings
from particle_filter.visibility import hidden_log_likelihood


@dataclass(frozen=True)
class Beams:
    """The beams of one scan that are scored."""

    hits_in_robot: Points
    """(B, 2) where they ended."""
    laser_in_robot: Points
    """(2,) where they started."""

    @property
    def count(self) -> int:
        """How many beams."""
        return len(self.hits_in_robot)


def beams_of(
    ranges: NDArray[np.floating],
    range_max_m: float,
    angle_min: float,
    angle_step: float,
    robot_from_laser: Pose,
    settings: SensorSettings,
) -> Beams:
    """Drop beams without return, thin the rest evenly, and place their ends round the robot."""
    longest = min(range_max_m, settings.max_range_m)
    chosen = usable_beams(ranges, longest, settings.max_beams)
    hits = points_in_robot(ranges, angle_min, angle_step, robot_from_laser, chosen)
    return Beams(hits, robot_from_laser[:2])


class SensorModel:
    """Weighs poses in one map."""

    def __init__(self, field: LikelihoodField, jumps: JumpField, settings: SensorSettings) -> None:
        self.field, self.jumps, self.settings = field, jumps, settings

    def log_likelihood(self, map_from_robot: Poses, beams: Beams) -> LogWeights:
        """(N,) log p(z | x), a sum over beams, without the exponent."""
        return scan_log_likelihood(map_from_robot, beams.hits_in_robot, self.field)

    def hidden(self, map_from_robot: Poses, beams: Beams) -> LogWeights:
        """(N,) what `log_likelihood` gave for beams through walls; costs forty times as much."""
        return hidden_log_likelihood(
            map_from_robot,
            beams.laser_in_robot,
            beams.hits_in_robot,
            self.field,
            self.jumps,
            self.settings.hidden_margin_m,
        )

    def ground_penalty(self, map_from_robot: Poses) -> LogWeights:
        """(N,) 0 on free ground, the settings' penalty elsewhere: walls do not pass for free."""
        penalty, field = self.settings.not_free_log_penalty, self.field
        return ground_log_penalty(
            map_from_robot, field.cells, field.cell_m, field.map_from_grid, penalty
        )
