"""How well the map explains the building, and so what a piece of wall is worth as evidence."""

import math
from typing import Annotated

import msgspec
from msgspec import Meta

USUAL, FIRST, MOST = 0.8, 30.0, 300.0
"""Share of a piece that a map explains at first; number of pieces after which what was seen counts
as much as that; and number of pieces that are remembered."""
BEST = 0.97
"""Largest share: even a true map has pieces that change."""
CORRELATED = 0.5
"""Pieces are not independent: factor on their evidence."""


class Familiarity(msgspec.Struct, frozen=True):
    """What is new of all scans, and what the probable places explain of it."""

    new: Annotated[float, Meta(ge=FIRST, le=2.0 * MOST)] = FIRST
    """Number of pieces, the older ones forgotten."""
    explained: Annotated[float, Meta(ge=0.0, le=2.0 * MOST)] = USUAL * FIRST

    def after(self, new: float, explained: float) -> "Familiarity":
        kept = min(1.0, MOST / (self.new + new))
        return Familiarity(kept * (self.new + new), kept * (self.explained + explained))

    def evidence(self, least: float) -> float:
        """Return the evidence of a piece that fits against one that does not [nat].

        At the right place the share q of the pieces fits, at a wrong one about a half. Of two
        places, the one where one more piece fits is therefore more probable by the log odds of q.
        It is at least `least`, because a map that explains little may still be the right one.
        """
        share = min(max(self.explained / self.new, 0.5), BEST)
        return max(least, CORRELATED * math.log(share / (1.0 - share))) if least else 0.0
