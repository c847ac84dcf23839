"""Over all experiments: how well calibrated, how often confidently wrong."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from evaluation.experiments.case import Algorithm
from evaluation.experiments.reliability import (
    Reliability,
    balanced_calibration_error,
    pooled,
)
from evaluation.experiments.results import ExperimentResult

MOST_CALIBRATION_ERROR = 0.05
MOST_CONFIDENTLY_WRONG = 0.01
LEAST_RIGHT_WHEN_SURE = 0.9


@dataclass(frozen=True)
class Summary:
    """Everything pooled."""

    estimates: Reliability
    """Every update's most probable place: claimed probability, and whether right."""
    places: Reliability
    """Every place of every update."""
    balanced_calibration_error: float | None
    """Of the estimates; each experiment counts alike."""
    updates: int
    confidently_wrong: float | None
    """Share of all updates; each counts alike."""
    confidently_wrong_each: float | None
    """Mean of the experiments' shares; each experiment counts alike."""
    localized_wrong: float | None
    """Share of all updates with the state `localized` and a wrong estimate."""

    @property
    def right_when_sure(self) -> float | None:
        """Share of the estimates with a probability of 0.9 or more that were right."""
        sure = self.estimates.bins[-1]
        return sure.right_share if sure.claims else None


def summary(results: Sequence[ExperimentResult], algorithm: Algorithm) -> Summary:
    """Pool all experiments that run with the one set of defaults."""
    results = [result for result in results if result.case.with_defaults]
    runs = [run for result in results for run in result.measures(algorithm) if run is not None]
    updates = sum(run.updates for run in runs)
    each = [
        _weighed([(run.confidently_wrong_share, run.updates) for run in measured])
        for result in results
        if (measured := [run for run in result.measures(algorithm) if run is not None])
    ]
    return Summary(
        estimates=pooled(result.reliability(algorithm) for result in results),
        places=pooled(result.reliability(algorithm, of_places=True) for result in results),
        balanced_calibration_error=balanced_calibration_error(
            result.reliability(algorithm) for result in results
        ),
        updates=updates,
        confidently_wrong=_weighed([(run.confidently_wrong_share, run.updates) for run in runs]),
        confidently_wrong_each=_weighed([(value, 1) for value in each]),
        localized_wrong=_weighed([(run.localized_wrong_share, run.updates) for run in runs]),
    )


def _weighed(values: Sequence[tuple[float | None, int]]) -> float | None:
    known = [(value, weight) for value, weight in values if value is not None]
    total = sum(weight for _, weight in known)
    return math.fsum(value * weight for value, weight in known) / total if total else None
