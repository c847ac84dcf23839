"""How well the map explains the building, and so what a piece of wall is worth as evidence."""

import math
from collections.abc import Sequence
from typing import Annotated

import msgspec
from msgspec import Meta

from clustermcl.belief.explained import Explained

USUAL, FRONT, OTHERS = 0.8, 0.65, 0.5
"""Shares at first: of a piece that the map explains, in front of its walls, and at wrong places."""
FIRST, MOST = 30.0, 300.0
"""Number of pieces after which what was seen counts as much as these; and number of pieces that are
remembered."""
BEST = 0.97
"""Largest share: even a true map has pieces that change."""
CORRELATED = 0.5
"""Pieces are not independent: factor on their evidence."""
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
        share = min(max(self.share, OTHERS), BEST)
        return CORRELATED * math.log(share / (1.0 - share))

    def after(self, new: float, explained: float) -> "Familiarity":
        kept = min(1.0, MOST / (self.new + new))
        return Familiarity(kept * (self.explained + explained), kept * (self.new + new))


class Learned(msgspec.Struct, frozen=True):
    """What all scans have shown of the map."""

    probable: Familiarity = Familiarity()
    """What the probable places explain."""
    in_front: Familiarity = Familiarity.of(FRONT)
    """The same by beams that go through no wall."""
    others: Familiarity = Familiarity.of(OTHERS)
    """What places explain other than the one that explains most."""

    def evidence_among(self, best: Familiarity, changed: float) -> float:
        """Return the evidence of a piece that fits at one of two places, not at the other [nat].

        Where others explain nearly as much as the best, as in a changed building with rooms alike,
        which of them explains one more piece is chance: the building may have changed at either
        place. In a true map it is what decides.
        """
        chance = 1.0 - (1.0 - changed) ** 2
        return max(best.evidence - chance * self.others.evidence, 0.0)

    def changed(self, piece_evidence: float) -> float:
        """Return how much the building has changed, 0 to 1.

        In a true map nearly all that is new fits in front of walls. It is 1 where the probable
        places explain no more than half of it so, and where pieces are no evidence.
        """
        return max(1.0 - self.in_front.evidence / piece_evidence, 0.0) if piece_evidence else 1.0

    def after(self, new: float, found: Sequence[tuple[float, Explained, bool]]) -> "Learned":
        """Return what is known after a scan.

        Args:
            new: number of new pieces.
            found: of each place its probability, the pieces that it explains, and whether it has
                explained most so far.
        """
        others = self.others
        for share, each, is_best in found:
            if not is_best:
                others = others.after(share * new, share * each.fitting)
        total = math.fsum(share for share, _, _ in found)
        if total == 0.0:
            return Learned(self.probable, self.in_front, others)
        fitting = math.fsum(share * each.fitting for share, each, _ in found) / total
        clear = math.fsum(share * each.clear for share, each, _ in found) / total
        return Learned(self.probable.after(new, fitting), self.in_front.after(new, clear), others)
