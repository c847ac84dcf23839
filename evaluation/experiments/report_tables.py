"""Tables and numbers as a report shows them."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from evaluation.experiments.case import Algorithm
from evaluation.experiments.figures import Figure, Reading, read
from evaluation.experiments.results import ExperimentResult
from evaluation.experiments.significance import p_value

NOTHING = "–"


class FigureRow(NamedTuple):
    """One figure, as text."""

    text: str
    target: str
    measured: str
    spread: str
    met: str
    beside: dict[Algorithm, str]
    """Of each algorithm beside Cluster-MCL, with the significance of the difference."""

    def texts(self, baselines: Sequence[Algorithm]) -> tuple[str, ...]:
        """The row with a column for each of the given algorithms."""
        others = (self.beside.get(algorithm, NOTHING) for algorithm in baselines)
        return self.text, self.target, self.measured, self.spread, self.met, *others


def figure_rows(result: ExperimentResult) -> Iterator[tuple[Figure, FigureRow]]:
    """All figures of an experiment, the other algorithms' beside Cluster-MCL's."""
    for figure, reading in result.readings("cluster-mcl"):
        yield figure, _figure_row(figure, reading, result)


def _figure_row(figure: Figure, reading: Reading, result: ExperimentResult) -> FigureRow:
    ours = result.by_seed("cluster-mcl")
    beside: dict[Algorithm, str] = {}
    for algorithm in result.case.baselines:
        theirs = result.by_seed(algorithm)
        text = measured_text(figure, read(figure, list(theirs.values())))
        p = p_value(figure, ours, theirs)
        beside[algorithm] = text if p is None else f"{text} (p {p_text(p)})"
    return FigureRow(
        text=figure.text,
        target=figure.target or NOTHING,
        measured=measured_text(figure, reading),
        spread=spread_text(reading),
        met=NOTHING if reading.met is None else "yes" if reading.met else "**no**",
        beside=beside,
    )


def p_text(p: float) -> str:
    """Two digits; what is under a thousandth is said to be that."""
    return "< 0.001" if p < 0.001 else f"{p:.2g}"


def measured_text(figure: Figure, reading: Reading) -> str:
    """A share as `19 of 20`, a mean or a quantile as a number with its unit."""
    if reading.passed is not None:
        return f"{reading.passed} of {reading.runs}" if reading.runs else NOTHING
    if reading.value is None:
        return "never" if figure.kind == "quantile" and reading.runs else NOTHING
    some = f" ({reading.measured} of {reading.runs} runs)"
    text = f"{number(reading.value)} {figure.unit}".rstrip()
    return text if reading.measured == reading.runs or figure.kind == "quantile" else text + some


def spread_text(reading: Reading) -> str:
    """Wilson's interval of a share, lowest and highest run of a mean."""
    if reading.low is None or reading.high is None:
        return NOTHING
    if reading.passed is not None:
        return f"{reading.low:.0%} to {reading.high:.0%}"
    return f"{number(reading.low)} to {number(reading.high)}"


def number(value: float) -> str:
    """Three digits, without an exponent for what people count."""
    if abs(value) >= 100.0:
        return f"{value:.0f}"
    return f"{value:.3g}" if abs(value) >= 1e-4 or value == 0.0 else f"{value:.1e}"


def seeds_text(seeds: Sequence[int]) -> str:
    """`seeds 0 to 9`, or each of them where some are missing."""
    ordered = sorted(seeds)
    if not ordered:
        return "no seed"
    if len(ordered) == 1:
        return f"seed {ordered[0]}"
    if ordered == list(range(ordered[0], ordered[-1] + 1)):
        return f"seeds {ordered[0]} to {ordered[-1]}"
    return f"seeds {', '.join(map(str, ordered))}"


def table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """A table in Markdown."""
    yield f"| {' | '.join(columns)} |"
    yield f"| {' | '.join('---' for _ in columns)} |"
    yield from (f"| {' | '.join(row)} |" for row in rows)
