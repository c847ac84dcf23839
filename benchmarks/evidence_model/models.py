"""Families of evidence models: how much of a difference in log evidence counts, and when."""

from dataclasses import dataclass

import numpy as np

from benchmarks.evidence_model.records import Floats

BEST_FIT = 0.69
"""Log-likelihood a beam of a perfect scan, nearly; residual is what lacks to it [nat/beam]."""


@dataclass(frozen=True)
class Sloped:
    """A share of small differences at each step, however near the last one; large ones whole."""

    slope: float
    knee_nat: float
    most_nat: float = np.inf

    def __call__(self, worse: Floats, *_: Floats) -> Floats:
        """As `Counted`."""
        beyond = np.maximum(worse - self.knee_nat, 0.0)
        counted = self.slope * np.minimum(worse, self.knee_nat) + beyond
        return np.asarray(np.minimum(counted, self.most_nat))


@dataclass(frozen=True)
class Tempered:
    """Differences count once for each view, and less if the best place explains less of a scan.

    Errors of the map repeat until the robot has driven on: the errors of scans correlate over
    `view_m`, so a scan counts by the share of its view that is new. Unexplained beams, such as
    those of people, add random errors to the fit of any place, so the information of a difference
    falls by the square of the residual.
    """

    view_m: float
    view_rad: float
    doubling_residual: float = np.inf
    """Residual at which the variance of a difference has doubled [nat/beam]."""
    alike_nat: float = 0.0
    """Differences well under this are as likely Monte Carlo error of places that look alike."""

    def __call__(self, worse: Floats, fit: Floats, distance_m: Floats, turn_rad: Floats) -> Floats:
        """As `Counted`."""
        new = -np.expm1(-(distance_m / self.view_m + turn_rad / self.view_rad))
        residual = np.maximum(BEST_FIT - np.nan_to_num(fit, nan=BEST_FIT), 0.0)
        variance = 1.0 + (residual / self.doubling_residual) ** 2
        unlike = worse / np.maximum(worse + self.alike_nat, 1e-12)
        return np.asarray(new / variance * unlike * worse)


def families() -> list[Sloped | Tempered]:
    """All that are compared."""
    return [
        *(Sloped(1.0, 0.0, most) for most in (0.2, 1.0, np.inf)),
        *(Sloped(slope, knee) for slope in (0.1, 0.2, 0.3) for knee in (3.0, 5.0)),
        *(
            Tempered(view, 2.0 * view, residual, alike)
            for view in (0.4, 0.6, 0.8, 1.0)
            for residual in (0.15, 0.25, 0.4, np.inf)
            for alike in (0.0, 0.3)
        ),
    ]
