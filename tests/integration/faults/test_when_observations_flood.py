"""A thousand observations a second, most of them wrong, while a robot drives."""

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import cycle

import numpy as np
import zenoh
from msgspec.structs import replace

from clustermcl.protocol import keys
from clustermcl.protocol.answers import Status
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.codec import encode
from clustermcl.protocol.steps import Observation, PositionField
from clustermcl.runtime.stop import StopFlag
from tests.integration.faults.live_robot import BRIDGE, WORLD, Robot, with_bridge
from tests.integration.running import running
from tests.integration.waiting import stretched_s, wait_until

RATE_HZ = 1000
HOUR_NS = 3600 * 10**9
STEPS = 25
RIGHT = Observation(
    sender="gnss", stamp_ns=0, mean=(0.0, 0.0), covariance=(400.0, 0.0, 0.0, 400.0)
)  # fmt: skip
"""The robot is within 20 m of the middle all along."""
REGION = PositionField(
    cell_m=1.0, log_likelihoods=ArrayBlob.of(np.zeros((64, 64)), "float32"), map_digest="other"
)
TAG = replace(RIGHT, sender="eye", landmark="tag", mean=(30.0, 0.0))
WRONG = {
    "malformed Observation: field": replace(RIGHT, mean=(math.nan, 0.0)),
    "malformed Observation: impossible": replace(RIGHT, covariance=(1.0, 2.0, 2.0, 1.0)),
    "reading refused: unknown landmark": replace(TAG, landmark="none"),
    "reading refused: field of another map": replace(RIGHT, field=REGION),
    "reading refused: observation from the future": RIGHT,
}
"""By the cause that is counted."""
TOO_MANY = "reading refused: too many observations"


def test_a_flood_of_observations_costs_no_step() -> None:
    with with_bridge(WORLD, landmarks=[{"id": "tag", "x": 7.7, "y": 0.0}]) as tested:
        robot = Robot(tested.session, WORLD, pace=1)  # 16 scans may wait: 1.6 s
        with robot.driving():
            wait_until(lambda: tested.step >= 0)
            with flood(tested.session) as sent, tested.client as client:
                began_s = time.monotonic()
                wait_until(lambda: tested.step >= STEPS and len(sent) >= RATE_HZ)
                took_s, due_s = time.monotonic() - began_s, len(sent) / RATE_HZ
                wait_until(lambda: not WRONG.keys() - dropped(client.status()).keys())
                robot.has_laser = False  # so that no step takes those that wait
                wait_until(lambda: TOO_MANY in dropped(client.status()))
                status = client.status()
    assert took_s < stretched_s(due_s), "it was a flood"
    assert status.steps_lost == 0
    assert not {"dropped laser", "dropped odometry"} & dropped(status).keys()
    steps = [belief.step for belief in tested.beliefs]
    assert steps == list(range(len(steps)))


@contextmanager
def flood(session: zenoh.Session) -> Iterator[list[int]]:
    """Publish observations, right and wrong in turn; the list grows with each."""
    sent = list[int]()
    kinds = [RIGHT, TAG, *WRONG.values()]

    def publish(stop: StopFlag) -> None:
        began_ns = time.monotonic_ns()
        for number, kind in enumerate(cycle(kinds)):
            if stop.wait(number / RATE_HZ - (time.monotonic_ns() - began_ns) * 1e-9):
                return
            future_ns = HOUR_NS if number % len(kinds) == len(kinds) - 1 else 0
            # A tag that is elsewhere at each sight is new each time.
            mean = (number % 97 * 1.1, *kind.mean[1:]) if kind is TAG else kind.mean
            stamped = replace(kind, stamp_ns=time.time_ns() + future_ns, mean=mean)
            session.put(keys.OBSERVATION_READING, encode(stamped))
            sent.append(number)

    with running(publish):
        yield sent


def dropped(status: Status) -> dict[str, int]:
    (health,) = (health for health in status.processes if health.sender == BRIDGE)
    return dict(health.dropped)
