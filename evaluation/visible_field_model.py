"""A likelihood field that removes, for each pose, the score of beams through walls."""

from dataclasses import dataclass

import numpy as np

from particle_filter.arrays import LogWeights, Poses
from particle_filter.likelihood_field_model import LikelihoodFieldModel
from particle_filter.sensor_model import Beams


@dataclass(frozen=True, eq=False)
class VisibleFieldModel(LikelihoodFieldModel):
    """Weighs poses by the field and by occlusion.

    Cluster-MCL corrects the evidence of whole clusters for occluded ends, by an average over a few
    poses (`correction`). A single particle set has no such evidence, so each pose's weight is
    corrected: by the same share of the same sum, with the same tolerance.
    """

    most_poses: int
    """Most poses for which rays are cast; more, as in a search's first steps, use only the field,
    which is a hundred times faster."""

    def log_likelihood(self, map_from_robot: Poses, beams: Beams) -> LogWeights:
        """Return (N,) log p(z | x), a sum over beams, without the exponent."""
        field = super().log_likelihood(map_from_robot, beams)
        if len(map_from_robot) > self.most_poses:
            return field
        tolerated = self.settings.occlusion_tolerance * beams.count
        occluded = np.maximum(self.occluded(map_from_robot, beams) - tolerated, 0.0)
        return np.asarray(field - self.settings.occlusion_weight * occluded)
