"""Your own arrays: a map of booleans, and scans as numpy arrays. No file and no process."""

import numpy as np

from clustermcl import ClusterMCL, GridMap, Reading

occupied = np.ones((84, 124), bool)  # row 0 has the lowest y; cells of 0.1 m
occupied[2:-2, 2:-2] = False  # a room of 12 m x 8 m with walls around it
occupied[2:12, 2:22] = True  # and a cabinet in one corner
mcl = ClusterMCL(GridMap.from_array(occupied, 0.1))

x, y = 8.0, 4.0  # the laser stands here, and looks east
angles = np.linspace(-np.pi, np.pi, 360, endpoint=False)
steps = np.arange(0.0, 15.0, 0.02)
rows = ((y + np.outer(np.sin(angles), steps)) / 0.1).astype(int).clip(0, 83)
columns = ((x + np.outer(np.cos(angles), steps)) / 0.1).astype(int).clip(0, 123)
ranges = steps[occupied[rows, columns].argmax(axis=1)]  # [m], counter-clockwise

belief = mcl.update(Reading((0.0, 0.0, 0.0), ranges, -np.pi, angles[1] - angles[0], 30.0))
for place in belief.hypotheses:
    print(f"{place.probability:.0%} at x {place.x_m:.1f} m, y {place.y_m:.1f} m")
