"""What the filter asks of every kind of observation.

An observation is right with a Gaussian error, or false. All likelihoods are relative to that of an
observation of nothing, so a pose that explains an observation badly gets 0 nat.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from clustermcl.filter.arrays import LogWeights, Pose, Poses
from clustermcl.filter.grid import Grid

NEGLIGIBLE = 36.0
"""Terms smaller than the largest by more than this are omitted, being below its rounding [nat]."""


@dataclass(frozen=True, eq=False)
class Landmarks:
    """The landmarks of a map."""

    names: tuple[str, ...]
    """(L,) name of each; landmarks of one class share their name."""
    positions: NDArray[np.float64]
    """(L, 2) x, y in the map [m]."""
    variances: NDArray[np.float64]
    """(L,) variance of a position along each axis [m^2]."""

    @classmethod
    def of(cls, rows: Iterable[tuple[str, float, float, float]]) -> "Landmarks":
        """Return the landmarks of rows: name, x [m], y [m], standard deviation [m]."""
        table = list(rows)
        sigmas = np.array([row[3] for row in table])
        positions = np.array([row[1:3] for row in table]).reshape(-1, 2)
        return cls(tuple(row[0] for row in table), positions, sigmas**2)

    def named(self, name: str) -> NDArray[np.bool_]:
        """Return (L,) which landmarks have a name."""
        return np.asarray(self._names == name)

    @cached_property
    def _names(self) -> NDArray[np.str_]:
        return np.array(self.names)

    @cached_property
    def distinct(self) -> int:
        """Number of names."""
        return len(set(self.names))

    def only(self, name: str) -> "Landmarks":
        """Return the landmarks with a name."""
        named = self.named(name)
        names = (name,) * int(np.count_nonzero(named))
        return Landmarks(names, self.positions[named], self.variances[named])


NO_LANDMARKS = Landmarks.of(())


@dataclass(frozen=True, eq=False)
class Kind(ABC):
    """What a sensor measured about the robot's pose at a step.

    `landmarks` and `grid` are the map's; false observations of a pose are spread over the grid.
    """

    mean: NDArray[np.float64]
    covariance: NDArray[np.float64]
    """(D, D) of the (D,) mean, positive definite."""
    outlier_probability: float
    """Probability that the observation is false."""
    share: float = 1.0
    """Share of the log-likelihood that is new: errors of successive observations are correlated."""

    @property
    def odds(self) -> float:
        """Of a right observation to a false one."""
        return 1.0 / self.outlier_probability - 1.0

    def moved(self, before_from_after: Pose) -> Self:
        """Return the observation as it would be after a motion (3,) of the robot.

        Of a position without heading, the direction of the motion is unknown: its length is added
        to the standard deviation.
        """
        x, y, _ = before_from_after.tolist()
        return replace(self, covariance=self.covariance + (x**2 + y**2) * np.eye(2))

    def blurred(self, by_m: float, by_rad: float) -> Self:
        """Return a less certain observation, for poses that represent a neighbourhood."""
        return replace(self, covariance=self.covariance + by_m**2 * np.eye(2))

    @abstractmethod
    def arrays(self, landmarks: Landmarks, grid: Grid) -> Mapping[str, NDArray[Any]]:
        """Return its rows of `ObservationArrays`."""

    @abstractmethod
    def log_average_ratio(self, landmarks: Landmarks, grid: Grid) -> float:
        """Return the log of the average likelihood ratio over all poses in free space [nat].

        The integral of a Gaussian over the map is one: its parts outside are neglected.
        """

    @abstractmethod
    def largest_log_ratio(self, landmarks: Landmarks, grid: Grid) -> float:
        """Return the log-likelihood ratio at the pose that the observation fits best [nat]."""

    @abstractmethod
    def outlier_probability_at(self, pose: Pose, landmarks: Landmarks, grid: Grid) -> float:
        """Return the probability that the observation is false if the robot is at a (3,) pose."""

    @abstractmethod
    def draw(self, landmarks: Landmarks, grid: Grid, count: int, rng: np.random.Generator) -> Poses:
        """Draw (count, 3) poses that the observation allows; (0, 3) if there are none."""

    def density(
        self, poses: Poses, excess: LogWeights, landmarks: Landmarks, grid: Grid
    ) -> NDArray[np.float64]:
        """Return the (N,) densities of `draw` at free (N, 3) poses, relative to an even spread.

        `excess` are the (N,) likelihood ratios of the poses, minus one.
        """
        return excess / self.informativeness(landmarks, grid)

    def informativeness(self, landmarks: Landmarks, grid: Grid) -> float:
        """Return a number that is largest for the observation to draw poses from."""
        return math.expm1(replace(self, share=1.0).log_average_ratio(landmarks, grid))


def density(off: NDArray[np.float64], covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (N,) densities at (N, D) differences from the mean of one Gaussian, or of N."""
    squares = (off[:, None] @ np.linalg.inv(covariance) @ off[:, :, None])[:, 0, 0]
    return np.asarray(np.exp(-0.5 * squares) / np.sqrt(np.linalg.det(math.tau * covariance)))
