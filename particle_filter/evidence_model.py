"""What a scan's evidence is worth between places (docs/evidence.md).

The average likelihood of a cluster's particles errs, for the map is not the building: it lacks
what was moved, and it is a little wrong everywhere. Such errors lie within a nat or two, last for
metres of way, and favour a wrong place as often as the true one. What is far above them hardly
ever does. So a difference counts little while it could be an error, and in full beyond.
"""

import math

import numpy as np
from numpy.typing import NDArray

from particle_filter.arrays import Pose
from particle_filter.poses import between
from particle_filter.settings import BeliefSettings, SensorSettings


def counted(
    log_evidence: NDArray[np.float64], rules: BeliefSettings, views: float = 1.0
) -> NDArray[np.float64]:
    """How much each hypothesis has lost against the one that fits best, as it counts.

    A difference d to the best counts as `evidence_slope` * d up to `evidence_knee`, and each nat
    beyond in full. A slope of one is the paper's update.

    Args:
        log_evidence: (K,) log of each one's average likelihood; NaN, a missing report, stays.
        rules: slope and knee.
        views: how many independent views of the building it was gathered over; the errors of
            each lie within the knee.

    Returns:
        (K,) logarithms of at most zero.
    """
    if views <= 0.0 or np.all(np.isnan(log_evidence)):
        return np.where(np.isnan(log_evidence), log_evidence, 0.0)
    lost = np.nanmax(log_evidence) - log_evidence
    beyond = np.maximum(lost - views * rules.evidence_knee, 0.0)
    return np.asarray(-(rules.evidence_slope * (lost - beyond) + beyond))


def view_weight(odom_from_before: Pose, odom_from_after: Pose, settings: SensorSettings) -> float:
    """How much of an independent view of the building a scan is, from 0 to 1.

    A robot that stands sees the same again, errors of the map included, however often it looks.

    Args:
        odom_from_before: (3,) where the last scan was weighed.
        odom_from_after: (3,) where this one was taken.
        settings: how far apart views are independent.
    """
    x, y, turn = between(odom_from_before, odom_from_after)
    moved = math.hypot(x, y) / settings.view_distance_m + abs(turn) / settings.view_turn_rad
    return min(float(moved), 1.0)
