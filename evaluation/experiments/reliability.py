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


def balanced_calibration_error(parts: Iterable[Reliability]) -> float | None:
    """The expected calibration error if each part had as many claims as any other."""
    held = [part for part in parts if part.claims]
    if not held:
        return None
    gaps = [0.0] * BINS
    for part in held:
        for index, each in enumerate(part.bins):
            gaps[index] += (each.probability_sum - each.right) / part.claims
    return sum(map(abs, gaps)) / len(held)


def pooled(parts: Iterable[Reliability]) -> Reliability:
    """All claims together."""
    total = Reliability()
    for part in parts:
        for into, add in zip(total.bins, part.bins, strict=True):
            into.claims += add.claims
            into.right += add.right
            into.probability_sum += add.probability_sum
    return total
