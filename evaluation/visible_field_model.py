"""A likelihood field that takes back, for each pose, what it gave for beams through walls."""

from dataclasses import dataclass

import numpy as np

from particle_filter.arrays import LogWeights, Poses
from particle_filter.likelihood_field_model import LikelihoodFieldModel
from particle_filter.sensor_model import Beams


@dataclass(frozen=True, eq=False)
class VisibleFieldModel(LikelihoodFieldModel):
    """Weighs poses by the field and by what the laser can have seen.

    Cluster-MCL takes hidden ends back from the evidence of whole clusters, from an average over a
    few poses (`correction`). One cloud has no evidence of parts, so its poses' own weights carry
    the same: the same share of the same sum, the same tolerance, but pose by pose.
    """

    most_poses: int
    """Of more, as in the first steps of a search, only the field is asked: rays cost a hundred
    times as much."""

    def log_likelihood(self, map_from_robot: Poses, beams: Beams) -> LogWeights:
        """(N,) log p(z | x), a sum over beams, without the exponent."""
        field = super().log_likelihood(map_from_robot, beams)
        if len(map_from_robot) > self.most_poses:
            return field
        tolerated = self.settings.hidden_tolerance * beams.count
        hidden = np.maximum(self.hidden(map_from_robot, beams) - tolerated, 0.0)
        return np.asarray(field - self.settings.hidden_weight * hidden)
