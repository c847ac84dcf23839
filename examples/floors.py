"""Several floors in one belief: a tower of three, of which two look alike."""

from collections import Counter
from itertools import islice

from clustermcl import ClusterMCL, SimulatedRobot

robot = SimulatedRobot("tower", seed=0)
mcl = ClusterMCL(robot.map)
for reading in islice(robot, 900):
    if belief := mcl.update(reading):
        shares = Counter()
        for place in belief.hypotheses:
            shares[place.floor] += place.probability
        floors = ", ".join(f"{share:.0%} on {floor}" for floor, share in shares.most_common())
        print(f"step {belief.step}, {belief.state}: {floors}")
