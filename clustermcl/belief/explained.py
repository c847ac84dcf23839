"""How much a place explains of what is new of a scan."""

import numpy as np
from numpy.typing import NDArray

from clustermcl.filter.laser.beam_fits import fit_and_through
from clustermcl.protocol.work import TrackReport

NO_PLACE = 0.2
"""Least share of what is new of a scan that a right place explains, without beams through walls."""


def explains(report: TrackReport, beams: NDArray[np.float64]) -> tuple[float, float, float] | None:
    """Return the evidence of a scan's beams at a place: all, but for, and only through walls [nat].

    Args:
        report: contains the fits of the beams.
        beams: (B,) evidence of each beam if it fits [nat].

    Returns:
        None: the report's beams are not these.
    """
    if len(report.fits) != len(beams):
        return None
    fits, through = fit_and_through(report.fits)
    clear = np.where(through, 0.0, fits)
    return tuple((np.array([fits, clear, through]) @ beams).tolist())
