"""Promise: a robot that was lifted to another place is found again, soon."""

from collections.abc import Callable

from soak_test.availability import BACK_WITHIN_S, Availability
from soak_test.true_poses import JudgedBelief
from soak_test.verdict import KEPT_BREAKS, Break, Verdict

FOUND_WITHIN_S = 60.0
"""A search takes seconds; all places that look alike are to be found, one after the other."""


class Kidnappings:
    """Told of every belief; knows while the robot is looked for, and nothing else can be asked.

    Args:
        availability: knows when nobody could look.
        found: whether a belief holds all places at which the robot may be.
    """

    def __init__(self, availability: Availability, found: Callable[[JudgedBelief], bool]) -> None:
        self._availability, self._found = availability, found
        self._count = 0
        self._since_ns: int | None = None
        self._took_s: list[float] = []
        self._late: list[Break] = []

    def looked_for(self, judged: JudgedBelief) -> bool:
        """Whether at this belief the robot has been lifted and not been found again."""
        if judged.kidnapped > self._count:
            self._miss(judged.at_ns)
            self._count, self._since_ns = judged.kidnapped, judged.at_ns
        if self._since_ns is not None and not judged.blind and self._found(judged):
            self._miss(judged.at_ns)
            self._took_s.append((judged.at_ns - self._since_ns) / 1e9)
            self._since_ns = None
        return self._since_ns is not None

    def verdict(self, now_ns: int) -> Verdict:
        """Over all kidnappings."""
        self._miss(now_ns)
        self._since_ns = None
        longest_s, late = max(self._took_s, default=0.0), self._late
        return Verdict(
            promise="a kidnapped robot is found again",
            target=f"within {FOUND_WITHIN_S:g} s",
            measured=f"{len(self._took_s)} times, longest {longest_s:.1f} s; {len(late)} late",
            kept=None if not self._took_s and not late else not late,
            breaks=tuple(late[:KEPT_BREAKS]),
            figures={"found": len(self._took_s), "longest_s": longest_s, "late": len(late)},
        )

    def _miss(self, now_ns: int) -> None:
        """Count it if the robot is looked for longer than promised."""
        if self._since_ns is None:
            return
        reachable = self._availability.reachable(self._since_ns, now_ns)
        allowed_s = FOUND_WITHIN_S + (0.0 if reachable else BACK_WITHIN_S)
        took_s = (now_ns - self._since_ns) / 1e9
        if took_s > allowed_s:
            self._late.append(Break(self._since_ns, f"not found for {took_s:.1f} s"))
