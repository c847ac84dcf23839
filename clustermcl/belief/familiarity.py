"""How well the map explains the building, and so what a piece of wall is worth as evidence."""

import math
from typing import Annotated

import msgspec
from msgspec import Meta

USUAL, FRONT, OTHERS = 0.8, 0.65, 0.5
"""Shares at first: of a piece that the map explains, in front of its walls, and at wrong places."""
FIRST, MOST = 30.0, 300.0
"""Number of pieces after which what was seen counts as much as these; and number of pieces that are
remembered."""
BEST = 0.97
"""Largest share: even a true map has pieces that change."""
CORRELATED = 0.5
"""Pieces are not independent: factor on their evidence."""
APART = 0.7
"""Least share of the evidence of a piece that counts among places which explain the same."""
_Pieces = Annotated[float, Meta(ge=0.0, le=2.0 * MOST)]


class Familiarity(msgspec.Struct, frozen=True):
    """Which share of what is new of all scans is explained."""

    explained: _Pieces = USUAL * FIRST
    new: Annotated[float, Meta(ge=FIRST, le=2.0 * MOST)] = FIRST
    """Number of pieces, the older ones forgotten."""

    @classmethod
    def of(cls, share: float) -> "Familiarity":
        """Return what is expected before anything was seen."""
        return cls(share * FIRST)

    @property
    def share(self) -> float:
        return self.explained / self.new

    @property
    def evidence(self) -> float:
        """Evidence of a piece that fits against one that does not [nat].

        At the right place the share q of the pieces fits, at a wrong one about a half. Of two
        places, the one where one more piece fits is therefore more probable by the log odds of q.
        """
        share = min(max(self.share, 0.5), BEST)
        return CORRELATED * math.log(share / (1.0 - share))

    def after(self, new: float, explained: float) -> "Familiarity":
        kept = min(1.0, MOST / (self.new + new))
        return Familiarity(kept * (self.explained + explained), kept * (self.new + new))
