"""Compares evidence models on records: chosen on training buildings, reported for all."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.evidence_model.models import Sloped, Tempered
from benchmarks.evidence_model.records import load
from benchmarks.evidence_model.replay import Replayed, Rules, Stack

TRAINING = {
    "clear": ("intel", "fr101", "hall", "office"),
    "poor map": ("wean-1", "wean-3"),
    "moved": ("hall-moved",),
    "people": ("people",),
}
"""Records on which parameters are chosen; all others are for testing."""
MOST_SURE_WRONG = 0.01
"""Of the steps of any group of training records."""
ALIKE, LEAST_ENTROPY = ("cross", "rectangle", "hall-symmetric"), 0.99
"""Records of indistinguishable places, and how even they must stay in every run."""


@dataclass(frozen=True)
class Figures:
    """The result of one record of some runs."""

    replayed: Replayed
    steps: int
    found: NDArray[np.bool_]
    """(R,) runs whose first scan's places held the truth: of the others its share is made up."""

    @cached_property
    def log_score(self) -> float:
        """Of the runs that found the truth; NaN without any."""
        scores = np.where(self._scored, self.replayed.log_score, np.nan)[self.found]
        return float(np.nanmean(scores)) if len(scores) else math.nan

    @cached_property
    def brier(self) -> float:
        return float(np.nanmean(self.replayed.brier))

    @cached_property
    def sure_wrong(self) -> float:
        return float(np.mean(self.replayed.sure_wrong[self._scored]))

    @cached_property
    def sure_by_end(self) -> float:
        return float(np.mean(np.isfinite(self.replayed.sure_right_from)))

    def sure_right_step(self, quantile: float) -> float:
        """A run that never is counts as its last step."""
        first = np.minimum(self.replayed.sure_right_from, self.steps)
        return float(np.quantile(first, quantile))

    @property
    def _scored(self) -> NDArray[np.bool_]:
        return np.asarray(np.isfinite(self.replayed.truth))


def figures_of(stack: Stack, rules: Rules) -> Figures:
    """Replay all runs of a record."""
    found = np.array([record.planted < 0 for record in stack.records])
    return Figures(stack.replayed(rules), len(stack.evidence), found)


def best_of(
    stacks: Mapping[str, Stack],
    models: Sequence[Sloped | Tempered],
    write_line: Callable[[str], None],
) -> Sloped | Tempered:
    """The model with the best mean log score of those that do not break the two limits."""
    scores = {}
    for model in models:
        rules = Rules(counted=model)
        groups = [
            [figures_of(stacks[name], rules) for name in names] for names in TRAINING.values()
        ]
        score = float(np.nanmean([each.log_score for figures in groups for each in figures]))
        wrong = max(float(np.mean([each.sure_wrong for each in figures])) for figures in groups)
        entropy = min(float(stacks[name].replayed(rules).entropy.min()) for name in ALIKE)
        write_line(f"| {model} | {score:.3f} | {wrong:.3f} | {entropy:.3f} |")
        if wrong <= MOST_SURE_WRONG and entropy >= LEAST_ENTROPY:
            scores[model] = score
    return max(scores, key=scores.__getitem__)


def table(stacks: Mapping[str, Stack], rules: Rules) -> Iterator[str]:
    """A Markdown table, a row for each record."""
    columns = (
        "record|role|truth found|log score|Brier|sure and right from|by the end|sure and wrong"
    )
    yield f"| {columns.replace('|', ' | ')} |"
    yield "|" + " --- |" * 8
    for name, stack in stacks.items():
        found = figures_of(stack, rules)
        middle, late = found.sure_right_step(0.5), found.sure_right_step(0.9)
        chosen_on = (*ALIKE, *(name for names in TRAINING.values() for name in names))
        role = "training" if name in chosen_on else "test"
        runs = f"{found.found.sum()} of {len(stack.records)}"
        yield (
            f"| {name} | {role} | {runs} | {found.log_score:.2f} | {found.brier:.3f} "
            f"| {middle:.1f}, {late:.1f} | {found.sure_by_end:.2f} | {found.sure_wrong:.4f} |"
        )


def stacks_of(folder: Path) -> dict[str, Stack]:
    """All records of a folder."""
    return {file.stem: Stack(load(file)) for file in sorted(folder.glob("*.npz"))}
