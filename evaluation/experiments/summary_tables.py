"""The part of a report about all experiments together."""

from collections.abc import Iterator, Sequence

from evaluation.experiments.case import ALGORITHMS
from evaluation.experiments.reliability import BINS, Reliability
from evaluation.experiments.report_tables import NOTHING, number, table
from evaluation.experiments.results import ExperimentResult
from evaluation.experiments.summary import (
    LEAST_RIGHT_WHEN_SURE,
    MOST_CALIBRATION_ERROR,
    MOST_CONFIDENTLY_WRONG,
    summary,
)

_COLUMNS = ("over all updates", "target", "Cluster-MCL", "met", "ordinary MCL")


def reliability_lines(results: Sequence[ExperimentResult]) -> Iterator[str]:
    """Calibration and confident errors, pooled over all experiments that run with the defaults."""
    ours, ordinary = (summary(results, algorithm) for algorithm in ALGORITHMS)
    yield "## Reliability over all experiments"
    yield ""
    yield (
        f"Pooled over {ours.updates:,} updates of Cluster-MCL and {ordinary.updates:,} of ordinary "
        "MCL, all with the one set of defaults; experiments with settings of their own are not in."
    )
    yield ""
    rows = [
        _row(
            "expected calibration error of the estimate (10 bins)",
            ours.estimates.expected_calibration_error,
            ordinary.estimates.expected_calibration_error,
            at_most=MOST_CALIBRATION_ERROR,
        ),
        _row(
            "expected calibration error, each experiment counted alike",
            ours.balanced_calibration_error,
            ordinary.balanced_calibration_error,
        ),
        _row(
            "expected calibration error of all places held",
            ours.places.expected_calibration_error,
            ordinary.places.expected_calibration_error,
        ),
        _row(
            "confidently wrong, share of the updates",
            ours.confidently_wrong,
            ordinary.confidently_wrong,
            at_most=MOST_CONFIDENTLY_WRONG,
        ),
        _row(
            "confidently wrong, each experiment counted alike",
            ours.confidently_wrong_each,
            ordinary.confidently_wrong_each,
        ),
        _row(
            "right, of the estimates with probability 0.9 or more",
            ours.right_when_sure,
            ordinary.right_when_sure,
            at_least=LEAST_RIGHT_WHEN_SURE,
        ),
        _row(
            "`localized` and wrong, share of the updates",
            ours.localized_wrong,
            ordinary.localized_wrong,
        ),
    ]
    yield from table(_COLUMNS, rows)
    yield ""
    yield from _bins(ours.estimates, ordinary.estimates)


def _row(
    text: str,
    ours: float | None,
    ordinary: float | None,
    *,
    at_least: float | None = None,
    at_most: float | None = None,
) -> tuple[str, ...]:
    target, met = NOTHING, NOTHING
    if at_least is not None:
        target = f">= {at_least:g}"
        met = _met(ours is not None and ours >= at_least)
    elif at_most is not None:
        target = f"<= {at_most:g}"
        met = _met(ours is not None and ours <= at_most)
    return text, target, _number(ours), met, _number(ordinary)


def _met(met: bool) -> str:
    return "yes" if met else "**no**"


def _number(value: float | None) -> str:
    return NOTHING if value is None else number(value)


def _bins(ours: Reliability, ordinary: Reliability) -> Iterator[str]:
    """What was claimed and what came true, bin by bin."""
    columns = ("claimed", "estimates", "mean claimed", "right", "ordinary MCL: estimates", "right")
    rows = []
    for index, (mine, other) in enumerate(zip(ours.bins, ordinary.bins, strict=True)):
        rows.append(
            (
                f"{index / BINS:.1f} to {(index + 1) / BINS:.1f}",
                f"{mine.claims:,}",
                f"{mine.mean_probability:.3f}" if mine.claims else NOTHING,
                f"{mine.right_share:.3f}" if mine.claims else NOTHING,
                f"{other.claims:,}",
                f"{other.right_share:.3f}" if other.claims else NOTHING,
            )
        )
    yield from table(columns, rows)
