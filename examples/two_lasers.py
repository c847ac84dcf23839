"""A live loop with two lasers: each has a name and angles of its own."""

from collections.abc import Iterator
from itertools import islice

from clustermcl import ClusterMCL, Reading, SimulatedRobot


def of_two(driven: Reading) -> Iterator[Reading]:
    """Split each scan of the simulated robot, as if two lasers had seen a half each."""
    if driven.ranges is None:
        yield driven  # odometry alone
        return
    half = len(driven.ranges) // 2
    for name, first in (("right", 0), ("left", half)):
        yield Reading(
            ranges=driven.ranges[first : first + half],
            angle_min=driven.angle_min + first * driven.angle_step,
            angle_step=driven.angle_step, range_max=driven.range_max,
            robot_from_laser=driven.robot_from_laser, stamp_ns=driven.stamp_ns, laser=name,
        )  # fmt: skip


robot = SimulatedRobot("hall", seed=2)
mcl = ClusterMCL(robot.map)
for driven in islice(robot, 600):  # in place of your drivers
    for reading in of_two(driven):
        if belief := mcl.update(reading):
            print(belief.step, belief.state, 1 + len(belief.scan.others), "lasers", belief.pose)
