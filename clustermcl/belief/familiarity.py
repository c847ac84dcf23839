"""How well the map explains the building, and so what a piece of wall is worth as evidence."""

import math
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

USUAL, FRONT, FIRST, MOST = 0.8, 0.65, 30.0, 300.0
"""Share of a piece that a map explains at first, and in front of its walls; number of pieces after
which what was seen counts as much as that; and number of pieces that are remembered."""
BEST = 0.97
"""Largest share: even a true map has pieces that change."""
CORRELATED = 0.5
"""Pieces are not independent: factor on their evidence."""


class Familiarity(msgspec.Struct, frozen=True):
    """What is new of all scans, and what the probable places explain of it."""

    new: Annotated[float, Meta(ge=FIRST, le=2.0 * MOST)] = FIRST
    """Number of pieces, the older ones forgotten."""
    explained: Annotated[float, Meta(ge=0.0, le=2.0 * MOST)] = USUAL * FIRST
    front: Annotated[float, Meta(ge=0.0, le=2.0 * MOST)] = FRONT * FIRST
    """What they explain by beams that are not occluded."""

    def after(self, new: float, explained: float, front: float) -> "Familiarity":
        sums = np.array([self.new + new, self.explained + explained, self.front + front])
        return Familiarity(*(sums * min(1.0, MOST / (self.new + new))).tolist())

    def evidence(self, least: float) -> float:
        """Return the evidence of a piece that fits against one that does not [nat].

        At the right place the share q of the pieces fits, at a wrong one about a half. Of two
        places, the one where one more piece fits is therefore more probable by the log odds of q.
        It is at least `least`, because a map that explains little may still be the right one.
        """
        return max(least, _evidence(self.explained / self.new)) if least else 0.0

    def behind(self, evidence: float) -> float:
        """Return the share, 0 to 1, of its evidence that a piece has which fits behind a wall.

        At a wrong place most of what is new fits only behind mapped walls; at the right one, only
        where the building has changed. So it is 1 where the probable places explain no more than
        half of what is new in front of walls.
        """
        return max(1.0 - _evidence(self.front / self.new) / evidence, 0.0)


def _evidence(share: float) -> float:
    share = min(max(share, 0.5), BEST)
    return CORRELATED * math.log(share / (1.0 - share))
