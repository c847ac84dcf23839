"""Cuts cables of processes and mends them: both ways, or in one direction."""

from collections.abc import Sequence
from typing import Protocol

_DIRECTIONS = {
    "both ways": {"to_router": False, "from_router": False},
    "to the router": {"to_router": False, "from_router": True},
    "from the router": {"to_router": True, "from_router": False},
}
"""What of a cut cable lets through."""


class SetCables(Protocol):
    """Tells the relay."""

    def __call__(self, pids: Sequence[int], *, to_router: bool, from_router: bool) -> None:
        """What the cables of these processes shall let through."""


class LinkCuts:
    """Knows who is cut off.

    Args:
        set_cables: tells the relay.
    """

    def __init__(self, set_cables: SetCables) -> None:
        self._set_cables = set_cables
        self._cut_off: set[int] = set()

    def any_cut_off(self, pids: Sequence[int]) -> bool:
        """Whether one of these is cut off."""
        return not self._cut_off.isdisjoint(pids)

    def cut(self, pids: Sequence[int], share: float) -> str:
        """Cut them off; returns in which direction.

        Args:
            share: in [0, 1): chooses it.
        """
        how = list(_DIRECTIONS)[int(share * len(_DIRECTIONS))]
        self._set_cables(pids, **_DIRECTIONS[how])
        self._cut_off.update(pids)
        return how

    def mend(self, pids: Sequence[int]) -> None:
        """Make their cables whole."""
        self._set_cables(pids, to_router=True, from_router=True)
        self._cut_off -= set(pids)

    def mend_all(self) -> None:
        """Make all cables whole."""
        if self._cut_off:
            self.mend(sorted(self._cut_off))
