"""Observations between messages and the kinds that the filter weighs."""

from typing import assert_never

import numpy as np

from clustermcl.filter.observations.field import Field
from clustermcl.filter.observations.fixes import PoseFix, PositionFix
from clustermcl.filter.observations.observed import Observed
from clustermcl.filter.observations.sighting import Sighting
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.steps import Observation, PositionField, Seen


def from_wire(message: Observation | Seen, share: float = 1.0) -> Observed:
    mean, size = np.array(message.mean), len(message.mean)
    covariance = np.reshape(message.covariance, (size, size))
    measured = mean, covariance, message.outlier_probability, share
    match message.landmark, message.field, size:
        case "", PositionField(cell_m=cell_m, log_likelihoods=values, map_digest=digest), _:
            return Field(
                *measured, cell_m=cell_m, log_likelihoods=values.array(), map_digest=digest
            )
        case "", None, 3:
            return PoseFix(*measured)
        case "", None, _:
            return PositionFix(*measured)
        case landmark, _, _:
            return Sighting(*measured, landmark=landmark)


def to_wire(seen: Observed, share: float) -> Seen:
    """Return the part of a step's message that says this, with a share."""
    landmark, field = "", None
    match seen:
        case Sighting():
            landmark = seen.landmark
        case Field():
            values = ArrayBlob.of(seen.log_likelihoods, "float32")
            field = PositionField(cell_m=seen.cell_m, log_likelihoods=values)
        case PoseFix() | PositionFix():
            pass
        case _:
            assert_never(seen)
    return Seen(
        landmark=landmark,
        mean=tuple(seen.mean.tolist()),
        covariance=tuple(seen.covariance.ravel().tolist()),
        outlier_probability=seen.outlier_probability,
        share=share,
        field=field,
    )
