"""What the clusters have gathered while a search ran: what its places are held against."""

import math

import msgspec

KEPT_STEPS = 100
"""Steps that a search may lie behind the clusters it is compared with."""


class SearchEvidence(msgspec.Struct):
    """Follows the belief since a search began; encoded, it is a part of the coordinator's state."""

    log_elsewhere: float = 0.0
    """Log of the probability, when the search began, that the robot was elsewhere."""
    log_off_map: float = -math.inf
    """Log of the probability, when the search began, that the robot was not on the map."""
    gathered: dict[int, float] = {}
    """Log-likelihood of all scans since the search began, up to each of the last steps."""
    explained: float = 0.0
    """Share of the search's places that clusters hold or that were admitted."""

    def gather(self, step: int, log_likelihood: float) -> None:
        """A step's scan was that likely before it was known where the robot is."""
        self.gathered[step] = next(reversed(self.gathered.values()), 0.0) + log_likelihood
        if len(self.gathered) > KEPT_STEPS:
            del self.gathered[next(iter(self.gathered))]

    def log_weight(self, step: int, log_evidence: float) -> float:
        """Log of the weight, beside the belief, of all that the search has found.

        Args:
            step: up to which it has searched.
            log_evidence: log of the average likelihood of all its scans over the whole map.
        """
        gathered = self.gathered.get(step)
        return -math.inf if gathered is None else self.log_elsewhere + log_evidence - gathered

    def newly_explained(self, share: float) -> float:
        """Of what is elsewhere still, how much is explained now that `share` of the search is."""
        before, self.explained = self.explained, max(share, self.explained)
        return 1.0 - (1.0 - self.explained) / (1.0 - before) if before < 1.0 else 0.0
