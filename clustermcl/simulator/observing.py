"""Other sensors: a camera that sees landmarks, and a receiver of satellite positions."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import hypot

import numpy as np

from clustermcl.filter.poses import between
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import Landmark, Observation


@dataclass(frozen=True, kw_only=True)
class Camera:
    """A camera that sees all landmarks within its range, also through walls.

    A share of its observations, `false_names`, has the name of a random landmark.
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


@dataclass(frozen=True, kw_only=True)
class Gnss:
    """A receiver of satellite positions: one fix a second outdoors, none indoors.

    A share of the fixes, `outliers`, is wrong by 50 m in a random direction. `indoors` is x and y
    of two opposite corners of the building [m].
    """

    sigma_m: float = 5.0
    bias_m: tuple[float, float] = (0.0, 0.0)
    outliers: float = 0.1
    indoors: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)

    def observe(
        self,
        stamp_ns: int,
        map_from_robot: PoseTuple,
        _landmarks: Sequence[Landmark],
        rng: np.random.Generator,
    ) -> Iterator[Observation]:
        """Yield the fix of a second, at the first tenth of it."""
        (x, y, _), (left, low, right, high) = map_from_robot, self.indoors
        if stamp_ns % 10**9 >= 10**8 or (left < x < right and low < y < high):
            return
        angle = rng.uniform(-np.pi, np.pi)
        wrong_m = 50.0 * float(rng.random() < self.outliers)
        error = wrong_m * np.array([np.cos(angle), np.sin(angle)])
        fix = np.array([x, y]) + np.array(self.bias_m) + error
        yield Observation(
            sender="gnss",
            stamp_ns=stamp_ns,
            mean=tuple((fix + self.sigma_m * rng.standard_normal(2)).tolist()),
            covariance=(self.sigma_m**2, 0.0, 0.0, self.sigma_m**2),
            outlier_probability=max(self.outliers, 0.05),
            correlation_s=0.5,
        )
