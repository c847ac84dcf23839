"""What the clusters have gathered while a search ran: what its places are held against."""

import math

import msgspec

KEPT_STEPS = 100
"""Steps that a search may lie behind the clusters it is compared with."""


class SearchEvidenceState(msgspec.Struct, frozen=True):
    """As it is handed on."""

    log_elsewhere: float
    log_off_map: float
    gathered: tuple[tuple[int, float], ...]
    explained: float


class SearchEvidence:
    """Follows the belief from the begin of a search on.

    Args:
        log_elsewhere: log of the probability, when it began, that the robot was elsewhere.
        log_off_map: likewise, that it was not on the map.
    """

    def __init__(self, log_elsewhere: float = 0.0, log_off_map: float = -math.inf) -> None:
        self.log_elsewhere, self.log_off_map = log_elsewhere, log_off_map
        self._gathered: dict[int, float] = {}
        """Log-likelihood of all scans since the search began, up to each of the last steps."""
        self._total = 0.0
        self._explained = 0.0

    def gather(self, step: int, log_likelihood: float) -> None:
        """A step's scan was that likely before it was known where the robot is."""
        self._total += log_likelihood
        self._gathered[step] = self._total
        if len(self._gathered) > KEPT_STEPS:
            del self._gathered[next(iter(self._gathered))]

    def log_weight(self, step: int, log_evidence: float) -> float:
        """Log of the weight, beside the belief, of all that the search has found.

        Args:
            step: up to which it has searched.
            log_evidence: log of the average likelihood of all its scans over the whole map.
        """
        gathered = self._gathered.get(step)
        return -math.inf if gathered is None else self.log_elsewhere + log_evidence - gathered

    def newly_explained(self, share: float) -> float:
        """Of what is elsewhere still, how much is explained now that `share` of the search is."""
        before, self._explained = self._explained, max(share, self._explained)
        return 1.0 - (1.0 - self._explained) / (1.0 - before) if before < 1.0 else 0.0

    def state(self) -> SearchEvidenceState:
        """To be handed on."""
        return SearchEvidenceState(
            self.log_elsewhere, self.log_off_map, tuple(self._gathered.items()), self._explained
        )

    @classmethod
    def restored(cls, state: SearchEvidenceState) -> "SearchEvidence":
        """As another had it."""
        made = cls(state.log_elsewhere, state.log_off_map)
        made._gathered, made._explained = dict(state.gathered), state.explained
        made._total = state.gathered[-1][1] if state.gathered else 0.0
        return made
