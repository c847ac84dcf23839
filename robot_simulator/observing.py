"""Simulated sensors of landmarks and of the position."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import hypot

import numpy as np

from particle_filter.poses import between
from protocol.message import PoseTuple
from protocol.steps import Landmark, Observation


@dataclass(frozen=True, kw_only=True)
class Camera:
    """A camera that sees all landmarks within its range, also through walls.

    Args:
        range_m: largest distance of a landmark that is seen.
        sigma_m: standard deviation of the measured position along each axis.
        false_names: share of sights with the name of a random landmark.
    """

    range_m: float = 3.0
    sigma_m: float = 0.1
    false_names: float = 0.0

    def observe(
        self,
        stamp_ns: int,
        map_from_robot: PoseTuple,
        landmarks: Sequence[Landmark],
        rng: np.random.Generator,
    ) -> Iterator[Observation]:
        """Yield what is seen from a pose."""
        for landmark in landmarks:
            at = np.array([landmark.x, landmark.y, 0.0])
            seen = between(np.array(map_from_robot), at)[:2]
            if hypot(*seen) > self.range_m:
                continue
            is_false = rng.random() < self.false_names
            named = landmarks[int(rng.integers(len(landmarks)))] if is_false else landmark
            mean = (seen + self.sigma_m * rng.standard_normal(2)).tolist()
            yield _observation("camera", stamp_ns, mean, self.sigma_m, self.false_names, named.name)


@dataclass(frozen=True, kw_only=True)
class Gnss:
    """A receiver of satellite positions, one fix a second.

    Args:
        sigma_m: standard deviation of a fix along each axis.
        bias_m: constant error in x and y.
        outliers: share of fixes that are wrong by `outlier_m` in a random direction.
        outlier_m: error of these.
    """

    sigma_m: float = 5.0
    bias_m: tuple[float, float] = (0.0, 0.0)
    outliers: float = 0.1
    outlier_m: float = 50.0

    def observe(
        self, stamp_ns: int, map_from_robot: PoseTuple, rng: np.random.Generator
    ) -> Iterator[Observation]:
        """Yield the fix of a second, at the first tenth of it."""
        if stamp_ns % 10**9 >= 10**8:
            return
        angle = rng.uniform(-np.pi, np.pi)
        wrong_m = self.outlier_m * float(rng.random() < self.outliers)
        error = wrong_m * np.array([np.cos(angle), np.sin(angle)])
        fix = map_from_robot[:2] + np.array(self.bias_m) + error
        mean = (fix + self.sigma_m * rng.standard_normal(2)).tolist()
        yield _observation("gnss", stamp_ns, mean, self.sigma_m, self.outliers)


def _observation(
    sender: str, stamp_ns: int, mean: Sequence[float], sigma_m: float, wrong: float, name: str = ""
) -> Observation:
    return Observation(
        sender=sender,
        stamp_ns=stamp_ns,
        landmark=name,
        mean=tuple(mean),
        covariance=(sigma_m**2, 0.0, 0.0, sigma_m**2),
        outlier_probability=max(wrong, 0.05),
        correlation_s=30.0 if name else 0.5,
    )
