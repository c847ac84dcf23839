"""What a check came to: a promise, its target, what was measured, and whether it was kept."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

KEPT_BREAKS = 200
"""Of each promise; a promise that is broken more often is broken anyway."""


@dataclass(frozen=True)
class Break:
    """Once that a promise was not kept."""

    at_ns: int
    what: str


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """On one promise."""

    promise: str
    target: str
    measured: str
    kept: bool | None
    """None: it could not be told, or nothing was promised."""
    breaks: tuple[Break, ...] = ()
    figures: dict[str, float] = field(default_factory=dict)
    """Numbers behind `measured`, for programs."""


def over_all(robots: dict[str, Sequence[Verdict]]) -> list[Verdict]:
    """One verdict a promise: that of the robot for which it went worst."""
    together: list[Verdict] = []
    for verdicts in zip(*robots.values(), strict=True):
        named = list(zip(robots, verdicts, strict=True))
        worst, verdict = min(named, key=lambda item: _order(item[1]))
        if len(robots) > 1 and verdict.kept is False:
            verdict = replace(verdict, measured=f"{verdict.measured} ({worst})")
        together.append(verdict)
    return together


def _order(verdict: Verdict) -> tuple[int, int]:
    """Broken before undecided before kept; of the broken the one with the most breaks."""
    return {False: 0, None: 1, True: 2}[verdict.kept], -len(verdict.breaks)
