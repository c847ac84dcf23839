"""The evidence of the clusters during a search, for comparison with the places it finds."""

import math
from typing import Annotated

from msgspec import Meta

from coordinator.part import FEW, LogProbability, Part
from protocol.message import Finite, Number

KEPT_STEPS = 100
"""Largest number of steps by which a search may lag behind the clusters."""


class SearchEvidence(Part):
    """The evidence of scans since a search began, and the share of its places that are clusters."""

    log_elsewhere: LogProbability = 0.0
    """Log of the probability, when the search began, that the robot was elsewhere."""
    log_off_map: LogProbability = -math.inf
    """Log of the probability, when the search began, that the robot was not on the map."""
    gathered: Annotated[dict[Number, Finite], FEW] = {}
    """Log-likelihood of all scans since the search began, up to each of the last steps."""
    explained: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.0
    """Share of the search's places that clusters hold or that were admitted."""

    def gather(self, step: int, log_likelihood: float) -> None:
        """Add the log-likelihood of a scan, averaged over the whole belief."""
        self.gathered[step] = next(reversed(self.gathered.values()), 0.0) + log_likelihood
        if len(self.gathered) > KEPT_STEPS:
            del self.gathered[next(iter(self.gathered))]

    def log_weight(self, step: int, log_evidence: float) -> float:
        """Return the log weight of all places of the search, relative to the belief.

        Args:
            step: the last step that the search has used.
            log_evidence: log of the average likelihood of all its scans over the whole map.
        """
        gathered = self.gathered.get(step)
        return -math.inf if gathered is None else self.log_elsewhere + log_evidence - gathered

    def newly_explained(self, share: float) -> float:
        """Return the share of elsewhere that is newly explained, at most 1.

        Args:
            share: share of the search's places that clusters hold or that were admitted.
        """
        before, self.explained = self.explained, max(share, self.explained)
        return 1.0 - (1.0 - self.explained) / (1.0 - before) if before < 1.0 else 0.0
