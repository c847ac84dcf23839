"""How much a place explains of what is new of a scan."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clustermcl.filter.laser.beam_fits import decoded
from clustermcl.protocol.work import TrackReport

NO_PLACE = 0.2
"""Least share of what is new of a scan that a right place explains, without beams through walls."""

_LEAST = 1e-9
"""Least sharpness, in place of none [nat]."""


class Explained(NamedTuple):
    """Numbers of pieces, among what is new of a scan, at a place."""

    fitting: float
    """Of beams that fit, by how well they fit: 1 on an obstacle, 0 far from all."""
    clear: float
    """The same but for beams through walls."""
    through: float
    """Of beams through walls, whether they fit or not."""


def explains(report: TrackReport, beams: NDArray[np.float64], sharpness: float) -> Explained | None:
    """Return what a place explains of a scan.

    Args:
        report: contains the fits of the beams.
        beams: (B,) how new the piece is at which each beam ends (`Pieces`).
        sharpness: log-likelihood ratio by which beams fit [nat]: 0 by their log-likelihood, at
            `through_beam_loss` by their likelihood, in between by a power of it.

    Returns:
        None: the report's beams are not these.
    """
    if len(report.fits) != len(beams):
        return None
    fits, through = decoded(report.fits)
    ratio = max(sharpness, _LEAST)
    sharp = np.exp(ratio * (fits - 1.0)) * np.expm1(-ratio * fits) / np.expm1(-ratio)
    each = np.array([sharp, ~through * sharp, through])
    return Explained(*(each @ beams).tolist())
