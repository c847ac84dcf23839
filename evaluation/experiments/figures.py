"""Figures of an experiment: what is measured over its runs, and what is asked of it."""

import math
import statistics
from collections.abc import Sequence
from typing import Literal

import msgspec

from evaluation.experiments.measures import RunMeasures

Kind = Literal["share of runs", "mean", "quantile"]


class Figure(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One line of an experiment's table.

    *share of runs*: the share of the runs whose measure lies within the bounds; a run without the
    measure, or one that failed, is not among them. Met if that share is at least `wanted_share`.
    *mean*: the mean of the measure over the runs that have it. Met if it lies within the bounds.
    *quantile*: the value that `quantile` of the runs do not exceed; a run without the measure, or
    one that failed, counts as never. Met if it lies within the bounds.
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
    quantile: float = 0.5
    """Of a quantile: the share of the runs."""

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

    def passes(self, run: RunMeasures | None) -> bool:
        """Whether a run has the measure, within the bounds."""
        value = None if run is None else getattr(run, self.measure)
        return value is not None and self.holds(value)

    def value_of(self, run: RunMeasures | None) -> float | None:
        """The measure of a run; infinite in place of none for a quantile."""
        value = None if run is None else getattr(run, self.measure)
        if value is None:
            return math.inf if self.kind == "quantile" else None
        return float(value)

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
    """The share, the mean or the quantile; None without a run to measure it on, and of a quantile
    that is never reached."""
    low: float | None
    """Wilson's 95 % interval of a share; else the lowest run that has the measure."""
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


def quantiles(
    text: str, measure: str, *, most_median: float | None = None, most_90: float | None = None
) -> tuple[Figure, Figure]:
    """The median of a measure over all runs, and what 90 % of them do not exceed."""
    both = ((0.5, "median", most_median), (0.9, "90 %", most_90))
    median, most = (
        Figure(
            text=f"{text}, {name}",
            measure=measure,
            kind="quantile",
            quantile=share,
            at_most=at_most,
        )
        for share, name, at_most in both
    )
    return median, most


def read(figure: Figure, runs: Sequence[RunMeasures | None]) -> Reading:
    """Compute a figure.

    Args:
        figure: which one.
        runs: of all runs that were begun and not interrupted; None: the run failed.
    """
    match figure.kind:
        case "share of runs":
            return _share(figure, runs)
        case "mean":
            values = [figure.value_of(run) for run in runs]
            known = [value for value in values if value is not None]
            return _over_runs(figure, known, len(runs), statistics.fmean(known) if known else None)
        case "quantile":
            known = sorted(v for run in runs if (v := figure.value_of(run)) is not None)
            value = known[math.ceil(figure.quantile * len(known)) - 1] if known else math.inf
            finite = [value for value in known if math.isfinite(value)]
            return _over_runs(figure, finite, len(runs), value if math.isfinite(value) else None)


def _share(figure: Figure, runs: Sequence[RunMeasures | None]) -> Reading:
    passed = sum(figure.passes(run) for run in runs)
    count, wanted = len(runs), figure.wanted_share
    low, high = _wilson_interval(passed, count) if count else (None, None)
    return Reading(
        value=passed / count if count else None,
        low=low,
        high=high,
        runs=count,
        measured=sum(run is not None and getattr(run, figure.measure) is not None for run in runs),
        passed=passed,
        met=passed >= wanted * count - 1e-9 if count and wanted is not None else None,
    )


def _wilson_interval(passed: int, count: int) -> tuple[float, float]:
    """Honest for few runs and for shares near 0 and 1: 20 of 20 give 84 to 100 %."""
    from scipy.stats import binomtest  # noqa: PLC0415 - heavy, for reports only

    interval = binomtest(passed, count).proportion_ci(confidence_level=0.95, method="wilson")
    return float(interval.low), float(interval.high)


def _over_runs(figure: Figure, values: Sequence[float], runs: int, value: float | None) -> Reading:
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
