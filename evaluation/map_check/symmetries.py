"""Symmetries of a map: transforms that carry many places to look-alike places."""

import math
from collections.abc import Sequence

import msgspec
import numpy as np

from grid_maps.grid_map import GridMap
from particle_filter.arrays import Poses
from particle_filter.gaussian import fit_gaussian
from particle_filter.places import cluster_by_source_point
from particle_filter.poses import compose, inverse

_LEAST_SHARE, _LEAST_PLACES = 0.15, 3
_NEAR_M, _NEAR_RAD = 1.0, 0.15
_NO_TURN_RAD = 0.1
_MOST = 256


class Symmetry(msgspec.Struct, frozen=True, kw_only=True):
    """A transform under which some places of the map look the same."""

    turn_rad: float
    """Angle of a rotation; 0: a translation."""
    about_m: tuple[float, float] | None
    """Centre of rotation; None: a translation."""
    shift_m: tuple[float, float] | None
    """Translation; None: a rotation."""
    share: float
    """Share of the tested places with a look-alike by this transform."""


def middle_of(grid_map: GridMap) -> tuple[float, float]:
    """Return the middle of the grid in the map frame [m]."""
    width_m, height_m = grid_map.size_m
    middle = np.array([width_m / 2, height_m / 2, 0.0])
    x, y, _ = compose(np.array(grid_map.map_from_grid), middle)
    return float(x), float(y)


def symmetries_of(found: Sequence[Poses], middle: tuple[float, float]) -> tuple[Symmetry, ...]:
    """Return the transforms that several places share, the most frequent first.

    Args:
        found: (N, 3) places that look alike, for each tested place, which is the first.
        middle: middle of the map [m], about which turns are compared, because errors of their
            angle have the least effect there.
    """
    to_middle = np.array([*middle, 0.0])
    movements, owners = [], []
    for owner, places in enumerate(found):
        centred = places - to_middle
        movements.append(compose(centred[1:], inverse(centred[0])))
        owners += [owner] * (len(places) - 1)
    if not owners:
        return ()
    moved, owner_of = np.vstack(movements), np.array(owners)
    labels, count = cluster_by_source_point(
        moved, np.zeros(len(moved)), _NEAR_M, _NEAR_RAD, max_clusters=_MOST
    )
    symmetries = []
    for label in range(count):
        members = labels == label
        count_of = len(np.unique(owner_of[members]))
        if count_of >= max(_LEAST_PLACES, _LEAST_SHARE * len(found)):
            mean, _ = fit_gaussian(moved[members], np.ones(np.count_nonzero(members)))
            symmetries.append(_symmetry(mean, middle, count_of / len(found)))
    return tuple(sorted(symmetries, key=lambda symmetry: -symmetry.share))


def _symmetry(movement: np.ndarray, middle: tuple[float, float], share: float) -> Symmetry:
    x, y, turn = movement.tolist()
    if abs(turn) < _NO_TURN_RAD:
        return Symmetry(turn_rad=0.0, about_m=None, shift_m=(x, y), share=share)
    # The centre is the fixed point p = R p + t.
    half, c = 0.5 / math.tan(turn / 2), 0.5
    about = (middle[0] + c * x - half * y, middle[1] + half * x + c * y)
    return Symmetry(turn_rad=turn, about_m=about, shift_m=None, share=share)
