"""Figures of an experiment: what is measured over its runs, and what is asked of it."""

import statistics
from collections.abc import Sequence
from typing import Literal

import msgspec

from evaluation.experiments.measures import RunMeasures

Kind = Literal["share of runs", "mean"]


class Figure(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One line of an experiment's table.

    *share of runs*: the share of the runs whose measure lies within the bounds; a run without the
    measure, or one that failed, is not among them. Met if that share is at least `wanted_share`.
    *mean*: the mean of the measure over the runs that have it. Met if it lies within the bounds.
    """

    text: str
    measure: str
    """Name of a field of `RunMeasures`."""
    kind: Kind
    at_least: float | None = None
    at_most: float | None = None
    wanted_share: float | None = None
    """Of a share of runs; None: nothing is asked."""
    unit: str = ""

    @property
    def asks(self) -> bool:
        """Whether there is a target."""
        if self.kind == "share of runs":
            return self.wanted_share is not None
        return self.at_least is not None or self.at_most is not None

    def holds(self, value: float) -> bool:
        """Whether a value lies within the bounds."""
        return (self.at_least is None or value >= self.at_least) and (
            self.at_most is None or value <= self.at_most
        )

    @property
    def target(self) -> str:
        """What is asked, in words."""
        if self.kind == "share of runs":
            return _share_target(self.wanted_share)
        bounds = [(">=", self.at_least), ("<=", self.at_most)]
        texts = [f"{sign} {bound:g}" for sign, bound in bounds if bound is not None]
        return " and ".join(texts) + (f" {self.unit}" if texts and self.unit else "")


def _share_target(wanted: float | None) -> str:
    if wanted is None:
        return ""
    return "all runs" if wanted == 1.0 else f">= {100 * wanted:.3g} % of the runs"


class Reading(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a figure came to."""

    value: float | None
    """The share, or the mean; None without a run to measure it on."""
    low: float | None
    """Wilson's 95 % interval of a share; the lowest run of a mean."""
    high: float | None
    runs: int
    """Runs in all, failed ones too."""
    measured: int
    """Runs that have the measure."""
    passed: int | None
    """Of a share: runs within the bounds."""
    met: bool | None
    """None: nothing is asked, or there was no run; a mean that no run has is not met."""


def rate(
    text: str,
    measure: str,
    *,
    wanted: float | None = 1.0,
    at_least: float | None = None,
    at_most: float | None = None,
) -> Figure:
    """In how many runs a measure lies within bounds."""
    return Figure(
        text=text,
        measure=measure,
        kind="share of runs",
        at_least=at_least,
        at_most=at_most,
        wanted_share=wanted,
    )


def mean(
    text: str,
    measure: str,
    *,
    at_least: float | None = None,
    at_most: float | None = None,
    unit: str = "",
) -> Figure:
    """A measure averaged over the runs."""
    return Figure(
        text=text, measure=measure, kind="mean", at_least=at_least, at_most=at_most, unit=unit
    )


def read(figure: Figure, runs: Sequence[RunMeasures | None]) -> Reading:
    """Compute a figure.

    Args:
        figure: which one.
        runs: of all runs that were begun and not interrupted; None: the run failed.
    """
    values = [None if run is None else getattr(run, figure.measure) for run in runs]
    if figure.kind == "share of runs":
        return _share(figure, values)
    return _mean(figure, [float(value) for value in values if value is not None], len(values))


def _share(figure: Figure, values: Sequence[float | None]) -> Reading:
    passed = sum(value is not None and figure.holds(value) for value in values)
    count, wanted = len(values), figure.wanted_share
    low, high = _wilson_interval(passed, count) if count else (None, None)
    return Reading(
        value=passed / count if count else None,
        low=low,
        high=high,
        runs=count,
        measured=sum(value is not None for value in values),
        passed=passed,
        met=passed >= wanted * count - 1e-9 if count and wanted is not None else None,
    )


def _wilson_interval(passed: int, count: int) -> tuple[float, float]:
    """Honest for few runs and for shares near 0 and 1: 20 of 20 give 84 to 100 %."""
    from scipy.stats import binomtest  # noqa: PLC0415 - heavy, for reports only

    interval = binomtest(passed, count).proportion_ci(confidence_level=0.95, method="wilson")
    return float(interval.low), float(interval.high)


def _mean(figure: Figure, values: Sequence[float], runs: int) -> Reading:
    value = statistics.fmean(values) if values else None
    held = value is not None and figure.holds(value)
    return Reading(
        value=value,
        low=min(values, default=None),
        high=max(values, default=None),
        runs=runs,
        measured=len(values),
        passed=None,
        met=held if runs and figure.asks else None,
    )
