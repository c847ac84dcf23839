"""Many places checked at once: a search tells hundreds of them with every scan."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from protocol.arrays import ArrayBlob, WireType
from protocol.message import MAX_POSE_M
from protocol.work import Place

_DTYPE: WireType = "float32"
"""What workers send samples as."""
_LITTLE = np.dtype(_DTYPE).newbyteorder("<")
_MAX_SHARE = 1.000001
"""Shares are sums of weights."""


def are_sound(places: Sequence[Place], max_step: int) -> bool:
    """Whether nothing is wrong with any of them; if not sure, each has to be looked at.

    Args:
        places: from the wire.
        max_step: steps stay below.
    """
    if not places:
        return True
    samples = [place.sample for place in places]
    clouds = [sample.map_from_robot for sample in samples]
    weights = [sample.log_weights for sample in samples]
    if not all(map(_is_cloud, clouds, weights)):
        return False
    covariances = np.array([place.covariance for place in places])
    poses = np.array([(*place.mean, *place.sample.odom_from_robot) for place in places])
    starts = np.cumsum([0, *(blob.shape[0] for blob in weights[:-1])])
    shares = np.array([place.share for place in places])
    with np.errstate(invalid="ignore", over="ignore"):
        variances, sums = covariances[:, [0, 4, 8]], covariances.sum(axis=1)
        best = np.maximum.reduceat(_joined(weights), starts)
    sound = (
        (shares >= 0.0) & (shares <= _MAX_SHARE),
        np.isfinite(sums),
        variances >= 0.0,
        np.isfinite(poses),
        np.abs(poses[:, [0, 1, 3, 4]]) < MAX_POSE_M,
        np.isfinite(_joined(clouds)),
        np.isfinite(best),
    )
    return all(0 <= one.step < max_step for one in samples) and all(map(np.all, sound))


def _is_cloud(poses: ArrayBlob, weights: ArrayBlob) -> bool:
    count = weights.shape[0] if len(weights.shape) == 1 else 0
    return (
        count > 0
        and poses.shape == (count, 3)
        and poses.dtype == weights.dtype == _DTYPE
        and len(poses.data) == 3 * len(weights.data) == 3 * count * _LITTLE.itemsize
    )


def _joined(blobs: Sequence[ArrayBlob]) -> NDArray[np.float32]:
    return np.frombuffer(b"".join(blob.data for blob in blobs), _LITTLE)
