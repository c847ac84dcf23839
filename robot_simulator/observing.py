"""A simulated camera that sees landmarks."""

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
            yield Observation(
                sender="camera",
                stamp_ns=stamp_ns,
                landmark=named.name,
                mean=tuple(mean),
                covariance=(self.sigma_m**2, 0.0, 0.0, self.sigma_m**2),
                outlier_probability=max(self.false_names, 0.05),
                correlation_s=30.0,
            )
