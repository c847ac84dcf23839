"""Records by which cause the log odds of each hypothesis change in a step."""

import math
from collections.abc import Sequence

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
    """The log probabilities of all hypotheses after each cause of a change, from the first on.

    Log odds are computed at the end of a step. Arrays of a few numbers are slower than lists.
    """

    def __init__(
        self, clusters: ClusterSet, reach: tuple[float, float] = (math.inf, math.inf)
    ) -> None:
        self._clusters, self._reach = clusters, reach
        self._entries: list[tuple[str, tuple[int, ...], list[float]]] = []
        self._facts: dict[str, NDArray[np.float64] | float] = {}
        self._with_facts: tuple[int, ...] = ()
        self._note_near("")
        self.note(_WIDTH)

    def note(self, cause: str) -> None:
        """Attribute all changes of the clusters since the last note to a cause."""
        held = self._clusters
        logs = [cluster.log_probability for cluster in held.clusters.values()]
        logs += (held.log_elsewhere, held.log_off_map)
        self._entries.append((cause, (*held.clusters, *_OUTSIDE), logs))

    def _note_near(self, cause: str) -> None:
        near, log_elsewhere = self._clusters.near(*self._reach)
        self.note_update(cause, np.array(near), 0.0, log_elsewhere, self._clusters.log_off_map)

    def note_update(
        self,
        cause: str,
        among: NDArray[np.float64],
        log_here: float,
        log_there: float,
        log_off: float,
    ) -> None:
        """Attribute all changes since the last note to a part of an update.

        Args:
            cause: name of it.
            among: (K,) log probabilities among the clusters.
            log_here: log probability of all clusters, which need not be normalised, nor those of:
            log_there: elsewhere on the map.
            log_off: off the map.
        """
        logs = [log + log_here for log in among.tolist()]
        logs += (log_there, log_off)
        self._entries.append((cause, (*self._clusters.clusters, *_OUTSIDE), logs))

    def note_facts(self, **facts: NDArray[np.float64] | float) -> None:
        """Note numbers of (K,) clusters, or one for all; NaN: unknown."""
        self._facts, self._with_facts = facts, tuple(self._clusters.clusters)

    def why(self, numbers: Sequence[int]) -> Why:
        """Return all changes, in the order of these clusters: the hypotheses."""
        self._note_near(_WIDTH)
        kept = (*numbers, *_OUTSIDE)
        (_, of, logs), *rest = self._entries
        before = dict(zip(of, log_odds(logs), strict=True))
        changes: dict[str, list[float]] = {}
        for cause, of, logs in rest:
            after = dict(zip(of, log_odds(logs), strict=True))
            change = [after.get(n, 0.0) - before.get(n, 0.0) for n in kept]
            so_far = changes.get(cause, [0.0] * len(kept))
            changes[cause] = [sum(each) for each in zip(so_far, change, strict=True)]
            before = after
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
