"""Which cluster has which colour, for as long as it lives."""

from collections.abc import Iterable

SLOTS = 8
"""Colours of the page; with more clusters, numbers beyond them repeat the colours, dashed."""


class ColourSlots:
    """Gives each cluster the free number that has been free for longest."""

    def __init__(self) -> None:
        self._of: dict[int, int] = {}
        self._free = list(range(SLOTS))
        """Longest free first: a newcomer does not look like the one that has just ended."""

    def assign(self, clusters: Iterable[int]) -> dict[int, int]:
        """The numbers of the clusters there are now; those of all others become free."""
        alive = list(clusters)
        for gone in sorted(self._of.keys() - set(alive)):
            self._free.append(self._of.pop(gone))
        for cluster in alive:
            if cluster not in self._of:
                self._of[cluster] = self._take()
        return dict(self._of)

    def _take(self) -> int:
        """One of the colours while there is one; then one beyond them."""
        if not self._free:
            return len(self._of)
        first = next((slot for slot in self._free if slot < SLOTS), self._free[0])
        self._free.remove(first)
        return first
