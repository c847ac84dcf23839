"""Symmetries of a map: movements that carry many of its places to places that look alike."""

import math
from collections.abc import Sequence

import msgspec
import numpy as np

from evaluation.map_check.look_alikes import LookAlikes
from particle_filter.gaussian import fit_gaussian
from particle_filter.poses import compose, inverse
from particle_filter.source_clustering import cluster_by_source_point

_LEAST_SHARE, _LEAST_PLACES = 0.15, 3
_NEAR_M, _NEAR_RAD = 1.0, 0.15
_NO_TURN_RAD = 0.1
_MOST = 256


class Symmetry(msgspec.Struct, frozen=True, kw_only=True):
    """The map looks the same after this movement, at some of its places."""

    turn_rad: float
    """0: it is shifted."""
    about_m: tuple[float, float] | None
    """The point about which it is turned; None: it is shifted."""
    shift_m: tuple[float, float] | None
    """None: it is turned."""
    share: float
    """Of the places that were looked at."""


def symmetries_of(found: Sequence[LookAlikes], middle: tuple[float, float]) -> tuple[Symmetry, ...]:
    """Movements that several of the places have in common, the most common first.

    Args:
        found: places that were looked at.
        middle: of the map; movements are compared there, where small errors of a turn do
            least.
    """
    to_middle = np.array([*middle, 0.0])
    movements, owners = [], []
    for owner, group in enumerate(found):
        centred = group.places - to_middle
        movements.append(compose(centred[1:], inverse(centred[0])))
        owners += [owner] * (len(group.places) - 1)
    if not owners:
        return ()
    moved, owner_of = np.vstack(movements), np.array(owners)
    labels, count = cluster_by_source_point(
        moved, np.zeros(len(moved)), _NEAR_M, _NEAR_RAD, max_clusters=_MOST
    )
    symmetries = []
    for label in range(count):
        members = labels == label
        places = len(np.unique(owner_of[members]))
        if places >= max(_LEAST_PLACES, _LEAST_SHARE * len(found)):
            mean, _ = fit_gaussian(moved[members], np.ones(np.count_nonzero(members)))
            symmetries.append(_symmetry(mean, middle, places / len(found)))
    return tuple(sorted(symmetries, key=lambda symmetry: -symmetry.share))


def _symmetry(movement: np.ndarray, middle: tuple[float, float], share: float) -> Symmetry:
    x, y, turn = movement.tolist()
    if abs(turn) < _NO_TURN_RAD:
        return Symmetry(turn_rad=0.0, about_m=None, shift_m=(x, y), share=share)
    # The point that stays where it is: p = R p + t.
    half, c = 0.5 / math.tan(turn / 2), 0.5
    about = (middle[0] + c * x - half * y, middle[1] + half * x + c * y)
    return Symmetry(turn_rad=turn, about_m=about, shift_m=None, share=share)
