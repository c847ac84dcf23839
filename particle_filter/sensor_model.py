"""One way to weigh poses by a scan, whichever sensor model the settings name."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from particle_filter.arrays import LogWeights, Points, Pose, Poses
from particle_filter.beam_model import RayMap, beam_log_likelihood
from particle_filter.ground import ground_log_penalty
from particle_filter.likelihood_field import LikelihoodField, scan_log_likelihood
from particle_filter.ray_casting import JumpField
from particle_filter.scan_points import points_in_robot, usable_beams
from particle_filter.settings import SensorSettings
from particle_filter.visibility import hidden_log_likelihood


@dataclass(frozen=True)
class Beams:
    """The beams of one scan that are scored."""

    ranges: NDArray[np.float64]
    """(B,) readings [m]; `max_range_m` or longer: no return."""
    angles: NDArray[np.float64]
    """(B,) directions in the laser's frame [rad]."""
    robot_from_laser: Pose
    max_range_m: float
    """The shorter of what the laser and the settings can see."""

    @property
    def count(self) -> int:
        """How many beams."""
        return len(self.ranges)

    @cached_property
    def hits_in_robot(self) -> Points:
        """(B, 2) where they ended."""
        return points_in_robot(self.ranges, self.angles, self.robot_from_laser)


def beams_of(
    ranges: NDArray[np.floating],
    range_max_m: float,
    angle_min: float,
    angle_step: float,
    robot_from_laser: Pose,
    settings: SensorSettings,
) -> Beams:
    """Choose the beams that are scored: invalid ones are dropped first, then the rest thinned.

    To the likelihood field a beam without return is invalid; to the beam model it tells that
    nothing was met.
    """
    longest = min(range_max_m, settings.max_range_m)
    readable = np.asarray(ranges, np.float64)
    if settings.model == "beam":
        readable = np.minimum(readable, longest)  # NaN stays NaN
        chosen = usable_beams(readable, np.inf, settings.max_beams)
    else:
        chosen = usable_beams(readable, longest, settings.max_beams)
    angles = np.asarray(angle_min + angle_step * chosen, np.float64)
    return Beams(np.asarray(readable[chosen], np.float64), angles, robot_from_laser, longest)


class SensorModel:
    """Weighs poses in one map."""

    def __init__(self, field: LikelihoodField, jumps: JumpField, settings: SensorSettings) -> None:
        self.field, self.jumps, self.settings = field, jumps, settings

    def log_likelihood(self, map_from_robot: Poses, beams: Beams) -> LogWeights:
        """(N,) log p(z | x), a sum over beams, without the exponent."""
        if self.settings.model == "likelihood_field":
            return scan_log_likelihood(map_from_robot, beams.hits_in_robot, self.field)
        return beam_log_likelihood(
            map_from_robot,
            beams.ranges,
            beams.angles,
            robot_from_laser=beams.robot_from_laser,
            ray_map=RayMap(self.jumps, self.field.cell_m, self.field.map_from_grid),
            max_range_m=beams.max_range_m,
            settings=self.settings,
        )

    def hidden(self, map_from_robot: Poses, beams: Beams) -> LogWeights:
        """(N,) what `log_likelihood` gave for beams through walls, each pose for some of them.

        Costs some hundred times as much as the field. The beam model follows every ray anyway.
        """
        if self.settings.model == "beam":
            return np.zeros(len(map_from_robot))
        return hidden_log_likelihood(
            map_from_robot,
            beams.robot_from_laser[:2],
            beams.hits_in_robot,
            self.field,
            self.jumps,
            self.settings.hidden_margin_m,
            self.settings.hidden_slack_rad,
            self.settings.visibility_beam_stride,
        )

    def ground_penalty(self, map_from_robot: Poses) -> LogWeights:
        """(N,) 0 on free ground, the settings' penalty elsewhere: walls do not pass for free."""
        penalty, field = self.settings.not_free_log_penalty, self.field
        return ground_log_penalty(
            map_from_robot, field.cells, field.cell_m, field.map_from_grid, penalty
        )
