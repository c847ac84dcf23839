"""Tables and numbers as a report shows them."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from evaluation.experiments.figures import Figure, Reading
from evaluation.experiments.results import ExperimentResult

NOTHING = "–"


class FigureRow(NamedTuple):
    """One figure, as text."""

    text: str
    target: str
    measured: str
    spread: str
    met: str
    ordinary: str


def figure_rows(result: ExperimentResult) -> Iterator[tuple[Figure, FigureRow]]:
    """All figures of an experiment, ordinary MCL's beside Cluster-MCL's."""
    both = zip(result.readings("cluster-mcl"), result.readings("mcl"), strict=True)
    for (figure, reading), (_, ordinary) in both:
        yield figure, figure_row(figure, reading, ordinary)


def figure_row(figure: Figure, reading: Reading, ordinary: Reading) -> FigureRow:
    """One figure."""
    return FigureRow(
        text=figure.text,
        target=figure.target or NOTHING,
        measured=measured_text(figure, reading),
        spread=spread_text(reading),
        met=NOTHING if reading.met is None else "yes" if reading.met else "**no**",
        ordinary=measured_text(figure, ordinary),
    )


def measured_text(figure: Figure, reading: Reading) -> str:
    """A share as `19 of 20`, a mean as a number with its unit."""
    if reading.passed is not None:
        return f"{reading.passed} of {reading.runs}" if reading.runs else NOTHING
    if reading.value is None:
        return NOTHING
    some = f" ({reading.measured} of {reading.runs} runs)"
    text = f"{number(reading.value)} {figure.unit}".rstrip()
    return text if reading.measured == reading.runs else text + some


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
