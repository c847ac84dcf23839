"""Verdicts on promises, and the outages that excuse a broken promise."""

from collections.abc import Collection
from dataclasses import dataclass, field

from tests.soak.schedule import Kind

KEPT_BREAKS = 200
"""Breaks recorded for each promise."""
BACK_WITHIN_S = 6.0
"""Recovery time after a fault: a process starts in 1 to 2 s, a link reconnects within 1 s, and a
new coordinator listens before it leads."""
NO_COORDINATOR = frozenset({
    Kind.COORDINATOR_KILLED, Kind.COORDINATOR_FROZEN, Kind.COORDINATOR_LINK_CUT,
})  # fmt: skip
NO_NETWORK = frozenset({Kind.ROUTER_KILLED, Kind.ROUTER_FROZEN, Kind.SLOW_NETWORK})
NO_WORKERS = frozenset({Kind.ALL_WORKERS_KILLED})


@dataclass(frozen=True)
class Break:
    """One violation of a promise."""

    at_ns: int
    """0: no particular time."""
    what: str


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """The result for one promise."""

    promise: str
    target: str
    measured: str
    kept: bool | None
    """None: not enough data."""
    breaks: tuple[Break, ...] = ()
    figures: dict[str, float] = field(default_factory=dict)
    """The numbers in `measured`, for programs."""


@dataclass(frozen=True)
class DoneFault:
    """An injected fault."""

    kind: Kind
    at_ns: int
    until_ns: int
    """Equal to `at_ns` for an instantaneous fault."""
    target: str
    """Names of the affected processes, separated by spaces."""
    how: str = ""
    """Details in words."""


class Outages:
    """The injected faults and the violations that they excuse."""

    def __init__(self) -> None:
        self.faults: list[DoneFault] = []

    def excuse(
        self, kinds: Collection[Kind], begin_ns: int, end_ns: int, after_s: float = BACK_WITHIN_S
    ) -> DoneFault | None:
        """The newest fault of these kinds whose consequences overlap a time; None: there is none.

        Args:
            kinds: that excuse it.
            begin_ns: of the time in question.
            end_ns: of the time in question.
            after_s: how long the consequences outlast the fault.
        """
        for fault in reversed(self.faults):
            until_ns = fault.until_ns + int(after_s * 1e9)
            if fault.kind in kinds and fault.at_ns <= end_ns and begin_ns <= until_ns:
                return fault
        return None
