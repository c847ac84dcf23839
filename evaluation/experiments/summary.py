"""Over all experiments: how well calibrated, how often confidently wrong."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from evaluation.experiments.case import Algorithm
from evaluation.experiments.measures import RunMeasures
from evaluation.experiments.reliability import (
    Reliability,
    mean_calibration_error,
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
    calibration_error_each: float | None
    """Of the estimates: mean of the experiments' own errors."""
    log_score_each: float | None
    """Mean of the experiments' logarithmic scores; each experiment counts alike."""
    brier_each: float | None
    """The same of Brier's score."""
    updates: int
    confidently_wrong: float | None
    """Share of all updates; each counts alike."""
    confidently_wrong_each: float | None
    """Mean of the experiments' shares; each experiment counts alike."""
    localized_wrong: float | None
    """Share of all updates with the state `localized` and a wrong estimate."""

    @property
    def sure_share(self) -> float | None:
        """Share of all updates that have an estimate with a probability of 0.9 or more."""
        return self.estimates.bins[-1].claims / self.updates if self.updates else None

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
    each = [[run for run in result.measures(algorithm) if run is not None] for result in results]
    return Summary(
        estimates=pooled(result.reliability(algorithm) for result in results),
        places=pooled(result.reliability(algorithm, of_places=True) for result in results),
        calibration_error_each=mean_calibration_error(
            result.reliability(algorithm) for result in results
        ),
        log_score_each=_mean_of_each(each, "log_score"),
        brier_each=_mean_of_each(each, "brier"),
        updates=updates,
        confidently_wrong=_weighed([(run.confidently_wrong_share, run.updates) for run in runs]),
        confidently_wrong_each=_mean_of_each(each, "confidently_wrong_share"),
        localized_wrong=_weighed([(run.localized_wrong_share, run.updates) for run in runs]),
    )


def _mean_of_each(each: Sequence[Sequence[RunMeasures]], measure: str) -> float | None:
    """Mean over the experiments of their mean over all updates."""
    means = [_weighed([(getattr(run, measure), run.updates) for run in runs]) for runs in each]
    return _weighed([(value, 1) for value in means])


def _weighed(values: Sequence[tuple[float | None, int]]) -> float | None:
    known = [(value, weight) for value, weight in values if value is not None]
    total = sum(weight for _, weight in known)
    return math.fsum(value * weight for value, weight in known) / total if total else None
