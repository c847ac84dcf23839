"""The states of a fleet behind one router: `python examples/fleet.py r1 r2 r3`."""

import sys

from clustermcl import Client
from clustermcl.protocol.errors import ClusterMclError

for name in sys.argv[1:] or ["robot"]:
    try:
        with Client(robot=name) as client:  # router="tcp/192.168.1.10:7447"
            answer = client.pose()
            print(f"{name}: {answer.state}, {answer.freshness}, {answer.probability:.0%}")
            for event in client.events().events[-3:]:
                print(f"  step {event.step}: {event.event}")
    except ClusterMclError as error:
        print(f"{name}: {error}")
