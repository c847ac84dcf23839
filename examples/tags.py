"""A camera reads a tag in one of four equal corridors, and the belief decides."""

from itertools import islice

import numpy as np

from clustermcl import ClusterMCL, SimulatedRobot

robot = SimulatedRobot("cross_tags", seed=1)  # its map has two tags
mcl = ClusterMCL(robot.map)
for reading in islice(robot, 6000):
    if belief := mcl.update(reading):
        print(belief.step, belief.state, len(belief.hypotheses), "places")
        if belief.state == "localized":
            break
    x, y, heading = robot.pose
    for tag in robot.map.landmarks:  # in place of your detector
        east, north = tag.x - x, tag.y - y
        ahead = np.cos(heading) * east + np.sin(heading) * north
        left = np.cos(heading) * north - np.sin(heading) * east
        if 0.0 < ahead < 5.0 and abs(left) < ahead:
            mcl.observe((ahead, left), np.diag([0.01, 0.01]), landmark=tag.name)
