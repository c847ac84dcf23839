"""Records by which cause the log odds of each hypothesis change in a step."""

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from clustermcl.belief.cluster_set import ClusterSet
from clustermcl.protocol.why import Why

MOST = 500.0
"""Bound of log odds: what is certain has no finite ones [nat]."""
DIGITS = 3
_WIDTH = "width of the cloud"
_OUTSIDE = (-2, -1)
"""Elsewhere and off the map, among numbers of clusters."""


class Ledger:
    """The log odds of all hypotheses after each cause of a change, from the first on."""

    def __init__(self, clusters: ClusterSet) -> None:
        self._clusters = clusters
        self._entries: list[tuple[str, dict[int, float]]] = []
        self._facts: dict[str, NDArray[np.float64] | float] = {}
        self._with_facts: tuple[int, ...] = ()
        self.note("", clusters.near())
        self.note(_WIDTH)

    def note(self, cause: str, log_values: NDArray[np.float64] | None = None) -> None:
        """Attribute all changes since the last note to a cause.

        Args:
            cause: name of it.
            log_values: (K + 2,) log probabilities since then, as `ClusterSet.log_probabilities`,
                but they need not be normalised; None: those of the clusters.
        """
        held = self._clusters
        logs = held.log_probabilities() if log_values is None else log_values
        odds = zip((*held.clusters, *_OUTSIDE), log_odds(logs.tolist()), strict=True)
        self._entries.append((cause, dict(odds)))

    def note_facts(self, **facts: NDArray[np.float64] | float) -> None:
        """Note numbers of (K,) clusters, or one for all; NaN: unknown."""
        self._facts, self._with_facts = facts, tuple(self._clusters.clusters)

    def why(self, numbers: Sequence[int]) -> Why:
        """Return all changes, in the order of these clusters: the hypotheses."""
        self.note(_WIDTH, self._clusters.near())
        kept = (*numbers, *_OUTSIDE)
        changes: dict[str, list[float]] = {}
        for (_, before), (cause, after) in pairwise(self._entries):
            change = (after.get(n, 0.0) - before.get(n, 0.0) for n in kept)
            so_far = changes.get(cause, [0.0] * len(kept))
            changes[cause] = [sum(each) for each in zip(so_far, change, strict=True)]
        shown = {cause: tuple(round(nat, DIGITS) for nat in of) for cause, of in changes.items()}
        shown = {cause: of for cause, of in shown.items() if any(of)}
        return Why(shown, self._shown_facts(numbers))

    def _shown_facts(self, numbers: Sequence[int]) -> dict[str, tuple[float, ...]]:
        """Return the facts in the order of these clusters; 0 where a cluster has none."""
        found: dict[str, tuple[float, ...]] = {}
        for name, values in self._facts.items():
            if isinstance(values, float):
                each = [values]
            else:
                of = dict(zip(self._with_facts, values.tolist(), strict=True))
                each = [of.get(number, 0.0) for number in numbers]
            found[name.replace("_", " ")] = tuple(
                0.0 if math.isnan(value) else round(min(max(value, -MOST), MOST), DIGITS)
                for value in each
            )
        return found


def log_odds(log_values: Sequence[float]) -> list[float]:
    """Return log odds, within `MOST`, of log probabilities that need not be normalised.

    Only the most probable hypothesis can have more than half, where 1 - p loses its digits.
    """
    peak = max(log_values)
    top = log_values.index(peak)
    ratios = [math.exp(value - peak) for value in log_values]
    ratios[top] = 0.0
    others = math.fsum(ratios)
    total = 1.0 + others
    odds = [
        max(value - peak - math.log(total - ratio), -MOST)
        for value, ratio in zip(log_values, ratios, strict=True)
    ]
    odds[top] = -math.log(max(others, math.exp(-MOST)))
    return odds
