"""Lifts, ramps and stairs: near one, the robot may be on another floor with the next view.

A scan in a lift whose doors are closed shows the cabin only, which is the same on all floors.
"""

import numpy as np

from clustermcl.belief.cluster_set import Cluster, ClusterSet
from clustermcl.belief.overlaps import is_near
from clustermcl.filter.settings import SearchSettings
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import LaserBeams, Scan

ENCLOSED_SHARE = 0.95
"""Share of the returns that end in the cabin if its doors are closed."""
LEAST_RETURNED = 0.5
"""Share of the beams that return in a cabin."""
CABIN_RADII = 2.0
"""A cabin reaches no farther from the laser than this, in radii of the link."""


def is_in_cabin(scan: Scan, held: ClusterSet) -> bool:
    """Return whether the best place is in a lift whose doors are closed."""
    if not (scan.floors.links and held.clusters):
        return False
    radius_m = scan.floors.radius_m(held.by_probability()[0].pose)
    if radius_m == 0.0:
        return False
    lasers: tuple[Scan | LaserBeams, ...] = (scan, *scan.others)
    count = sum(len(laser.ranges.array()) for laser in lasers)
    returned = np.concatenate([_returned(laser) for laser in lasers])
    near = int(np.count_nonzero(returned < CABIN_RADII * radius_m))
    return len(returned) > LEAST_RETURNED * count and near >= ENCLOSED_SHARE * len(returned)


def _returned(laser: Scan | LaserBeams) -> np.ndarray:
    ranges = laser.ranges.array()
    return ranges[(ranges > 0.0) & (ranges < laser.range_max_m)]


def ride(
    held: ClusterSet, scan: Scan, hazard: float, rules: SearchSettings, *, in_cabin: bool
) -> list[tuple[Cluster, PoseTuple, float]]:
    """Move probability to the other ends of links, where places are tracked.

    Args:
        held: the clusters, which are changed.
        scan: the step's scan, with the links.
        hazard: probability that the robot has changed its floor since the last scan.
        rules: distances within which a cluster is at the end of a ride.
        in_cabin: all floors of the link are equally probable.

    Returns:
        The ends where no place is tracked: the cluster, the pose there, and its probability, which
        the cluster still has. The most probable first.
    """
    gains, entering = dict[int, float](), list[tuple[Cluster, PoseTuple, float]]()
    for cluster in held.all():
        ends = scan.floors.rides(cluster.pose)
        leaves = len(ends) / (len(ends) + 1.0) if in_cabin else hazard
        for end in ends:
            share = cluster.probability * leaves / len(ends)
            means = [other.pose for other in held.all()]
            near = is_near(means, [end], rules.source_radius_m, rules.source_heading_rad)
            if not near.any():
                entering.append((cluster, end, share))
                continue
            there = held.all()[int(near.argmax())]
            for number, gain in ((cluster.cluster, -share), (there.cluster, share)):
                gains[number] = gains.get(number, 0.0) + gain
    held.move(gains)
    return sorted(entering, key=lambda each: -each[2])
