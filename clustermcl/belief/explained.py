"""How much a place explains of what is new of a scan."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clustermcl.filter.laser.beam_fits import decoded
from clustermcl.protocol.work import TrackReport

NO_PLACE = 0.2
"""Least share of what is new of a scan that a right place explains, without beams through walls."""


class Explained(NamedTuple):
    """Numbers of pieces, among what is new of a scan, at a place."""

    fitting: float
    """Of beams that fit, by how well they fit."""
    clear: float
    """The same but for beams through walls."""
    through: float
    """Of beams through walls, whether they fit or not."""


def explains(report: TrackReport, beams: NDArray[np.float64]) -> Explained | None:
    """Return what a place explains of a scan.

    Args:
        report: contains the fits of the beams.
        beams: (B,) how new the piece is at which each beam ends (`Pieces`).

    Returns:
        None: the report's beams are not these.
    """
    if len(report.fits) != len(beams):
        return None
    fits, through = decoded(report.fits)
    each = np.array([fits, np.where(through, 0.0, fits), through])
    return Explained(*(each @ beams).tolist())
