"""Why places became more or less probable in a step: changes of their log odds, by cause."""

from __future__ import annotations  # `help` shows names of types, not their definitions

from typing import Annotated, TypeAlias

import msgspec
from msgspec import Meta

from clustermcl.protocol.message import Finite

_Name = Annotated[str, Meta(max_length=40)]
Numbers: TypeAlias = Annotated[
    dict[_Name, Annotated[tuple[Finite, ...], Meta(max_length=2_000)]], Meta(max_length=40)
]
SHOWN_NAT = 0.05
"""Smaller changes are not shown."""


class Why(msgspec.Struct, frozen=True):
    """The causes of the changes from one belief to the next.

    The log odds of a hypothesis, log p / (1 - p), compare it with all others together, so they
    also fall because another one fits better. A new place begins with log odds of 0.
    """

    changes: Numbers = {}
    """By cause: changes of the log odds [nat], one for each hypothesis of the belief, one for
    elsewhere on the map, and one for off the map. Together they are the whole change."""
    facts: Numbers = {}
    """By name: numbers from which the changes follow, one for each hypothesis, or one for all."""

    def of(self, index: int) -> dict[str, float]:
        """Return the changes of one hypothesis by cause."""
        return {name: of[index] for name, of in self.changes.items() if index < len(of)}


def why_text(why: Why, index: int) -> str:
    """Return the changes of one hypothesis in words, the largest first; "" if there are none."""
    changes = sorted(why.of(index).items(), key=lambda change: -abs(change[1]))
    shown = [f"{name} {nat:+.1f}" for name, nat in changes if abs(nat) >= SHOWN_NAT]
    if not shown:
        return ""
    facts = ", ".join(
        f"{name} {of[index if len(of) > 1 else 0]:.2f}"
        for name, of in why.facts.items()
        if len(of) == 1 or index < len(of)
    )
    total = sum(nat for _, nat in changes)
    return f"log odds {total:+.1f} nat: {', '.join(shown)}" + (f" ({facts})" if facts else "")
