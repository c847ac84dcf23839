"""Whether probabilities mean what they say: of all claims of 70 %, 70 % should come true."""

from collections.abc import Iterable

import msgspec

BINS = 10


class ReliabilityBin(msgspec.Struct, kw_only=True):
    """Claims whose probability lies in one tenth of [0, 1]."""

    claims: int = 0
    right: int = 0
    probability_sum: float = 0.0

    @property
    def mean_probability(self) -> float:
        """What was claimed on average; 0 without a claim."""
        return self.probability_sum / self.claims if self.claims else 0.0

    @property
    def right_share(self) -> float:
        """What came true; 0 without a claim."""
        return self.right / self.claims if self.claims else 0.0


class Reliability(msgspec.Struct, kw_only=True):
    """Claims sorted by their probability into ten bins of equal width; the last includes 1."""

    bins: list[ReliabilityBin] = msgspec.field(
        default_factory=lambda: [ReliabilityBin() for _ in range(BINS)]
    )

    def add(self, probability: float, right: bool) -> None:
        """Take one claim and whether it was true."""
        chosen = self.bins[min(max(int(probability * BINS), 0), BINS - 1)]
        chosen.claims += 1
        chosen.right += right
        chosen.probability_sum += probability

    @property
    def claims(self) -> int:
        """How many there were."""
        return sum(part.claims for part in self.bins)

    def at_least(self, threshold: int) -> ReliabilityBin:
        """All claims of `threshold` tenths or more, together."""
        chosen = self.bins[threshold:]
        return ReliabilityBin(
            claims=sum(part.claims for part in chosen),
            right=sum(part.right for part in chosen),
            probability_sum=sum(part.probability_sum for part in chosen),
        )

    @property
    def expected_calibration_error(self) -> float | None:
        """Mean over all claims of |claimed - come true| of the claim's bin; None without claims.

        References:
            Naeini, Cooper, Hauskrecht, Obtaining well calibrated probabilities using Bayesian
            binning (2015).
        """
        if self.claims == 0:
            return None
        gaps = (abs(part.probability_sum - part.right) for part in self.bins)
        return sum(gaps) / self.claims


def mean_calibration_error(parts: Iterable[Reliability]) -> float | None:
    """Mean of the parts' own expected calibration errors; None without claims.

    One part's overconfidence is not made good by another one's hesitation, as where gaps of
    several parts are added up.
    """
    errors = [part.expected_calibration_error for part in parts]
    known = [error for error in errors if error is not None]
    return sum(known) / len(known) if known else None


def pooled(parts: Iterable[Reliability]) -> Reliability:
    """All claims together."""
    total = Reliability()
    for part in parts:
        for into, add in zip(total.bins, part.bins, strict=True):
            into.claims += add.claims
            into.right += add.right
            into.probability_sum += add.probability_sum
    return total
