"""Lifts, ramps and stairs: near one, the robot may be on another floor with the next view.

A scan in a lift whose doors are closed shows the cabin only, which is the same on all floors.
"""

import numpy as np

from clustermcl.belief.cluster_set import Candidate, Cluster, ClusterSet
from clustermcl.belief.given_places import candidate
from clustermcl.belief.overlaps import is_near
from clustermcl.filter.random_streams import Purpose
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


def ride(held: ClusterSet, scan: Scan, news: float, *, in_cabin: bool) -> list[Candidate]:
    """Move probability to the other ends of links, which the robot may have taken.

    Args:
        held: the clusters, which are changed.
        scan: the step's scan, with the links.
        news: share of the scan that is new.
        in_cabin: all floors of the link are equally probable.

    Returns:
        Places at the ends where none is tracked, the most probable first.
    """
    settings, rules = held.settings, held.rules
    if rules.link_probability == 0.0:
        return []
    gains, ends = dict[int, float](), list[tuple[Cluster, PoseTuple, float]]()
    for cluster in held.all():
        others = scan.floors.rides(cluster.pose)
        leaves = len(others) / (len(others) + 1.0) if in_cabin else news * rules.link_probability
        for end in others:
            share = cluster.probability * leaves / len(others)
            means = [other.pose for other in held.all()]
            near = is_near(means, [end], *settings.search.reach)
            if not near.any():
                ends.append((cluster, end, share))
                continue
            there = held.all()[int(near.argmax())]
            for number, gain in ((cluster.cluster, -share), (there.cluster, share)):
                gains[number] = gains.get(number, 0.0) + gain
    held.move(gains)
    ends.sort(key=lambda each: -each[2])
    entering: list[Candidate] = []
    for (cluster, end, share), leaving in zip(ends, held.room(), strict=False):
        if share <= max(leaving, rules.least_probability):
            break
        place = candidate(
            share,
            end,
            cluster.covariance,
            seed=settings.seed,
            purpose=Purpose.RIDE,
            entity=held.next_cluster + len(entering),
            step=scan.step,
            odom_from_robot=scan.odom_from_robot,
        )
        held.move({cluster.cluster: -share})
        entering.append((place, "ride"))
    return entering
