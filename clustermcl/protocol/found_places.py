"""The places that a search considers possible, as columns of numbers.

A search reports hundreds of places after every scan. The coordinator would spend more time on
decoding a list of structures than on using the places.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.message import MAX_POSE_M, Part, PoseTuple

_MAX_SHARE = 1.000001  # shares are sums of rounded weights


class FoundPlaces(Part, frozen=True, kw_only=True):
    """P places, most probable first, each with particles from which it can be tracked."""

    odom_from_robot: PoseTuple
    """Odometry at the report's scan."""
    share: ArrayBlob
    """(P,) float64: share of the weight of all places that the shard found."""
    mean: ArrayBlob
    """(P, 3) float64: x [m], y [m], heading [rad]."""
    covariance: ArrayBlob
    """(P, 9) float64: the 3 x 3 matrix, row by row [m^2, m rad, rad^2]."""
    count: ArrayBlob
    """(P,) int32: particles of each place; one where it is too improbable to be tracked."""
    particles: ArrayBlob
    """(S, 3) float32: samples of the places in order, equally weighted within a place."""

    def __len__(self) -> int:
        return len(self.share.array())

    @classmethod
    def of(
        cls,
        odom_from_robot: PoseTuple,
        share: ArrayLike,
        mean: ArrayLike,
        covariance: ArrayLike,
        particles: Sequence[NDArray[np.floating]],
    ) -> "FoundPlaces":
        """Pack places; `covariance` is (P, 3, 3) or (P, 9), `particles` (n, 3) for each place."""
        return cls(
            odom_from_robot=odom_from_robot,
            share=ArrayBlob.of(np.reshape(share, -1), "float64"),
            mean=ArrayBlob.of(np.reshape(mean, (-1, 3)), "float64"),
            covariance=ArrayBlob.of(np.reshape(covariance, (-1, 9)), "float64"),
            count=ArrayBlob.of(np.array([len(one) for one in particles], np.int32), "int32"),
            particles=ArrayBlob.of(np.concatenate([np.empty((0, 3)), *particles]), "float32"),
        )


def found_places_problem(found: FoundPlaces) -> str | None:
    """Return why these places are invalid, or None; or raise a `MalformedMessageError`."""
    share = found.share.checked(None, dtype="float64")
    mean = found.mean.checked(len(share), 3, dtype="float64")
    variances = found.covariance.checked(len(share), 9, dtype="float64")[:, ::4]
    count = found.count.checked(len(share), dtype="int32")
    particles = found.particles.checked(None, 3, dtype="float32")
    if not np.all((share >= 0.0) & (share <= _MAX_SHARE)):
        return "a share outside 0 to 1"
    if not np.all(np.abs(mean[:, :2]) < MAX_POSE_M):
        return "a place out of range"
    if not np.all(variances >= 0.0):
        return "a covariance with a negative variance"
    is_counted = np.all(count > 0) and count.sum(dtype=np.int64) == len(particles)
    return None if is_counted else "counts that do not match the particles"
