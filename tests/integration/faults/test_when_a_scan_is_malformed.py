"""docs/failures.md: a scan is malformed, empty, all out of range, not finite, from the future.

It is counted by its cause, said once in the log, dropped; the filters do not notice.
"""

import time

import numpy as np

from clustermcl.stack import WORKERS
from protocol import keys
from protocol.answers import Status
from protocol.arrays import ArrayBlob
from protocol.codec import encode
from protocol.steps import LaserReading
from tests.integration.faults.live_robot import BRIDGE, with_live_robot
from tests.integration.waiting import wait_until

NOT_MESSAGES = {
    "empty": b"",
    "no MessagePack": b"\xc1\xff\x00",
    "another schema": b"\x81\xa6schema\xa9unheard/1",
    "cut off": encode(LaserReading(
        sender="robot", stamp_ns=1, ranges=ArrayBlob.of(np.ones(5), "float32"),
        angle_min_rad=0.0, angle_step_rad=0.1, range_max_m=10.0, robot_from_laser=(0.0, 0.0, 0.0),
    ))[:-7],
}  # fmt: skip

TIMES = 5
MALFORMED = {
    "malformed LaserReading: not MessagePack",
    "malformed LaserReading: schema",
    "reading refused: no beams",
    "reading refused: no returns",
}


def dropped_by(status: Status, process: str) -> dict[str, int]:
    """A process's counters of dropped messages, by cause."""
    (health,) = (health for health in status.processes if health.sender == process)
    return dict(health.dropped)


def reading(ranges: np.ndarray, stamp_ns: int) -> bytes:
    return encode(
        LaserReading(
            sender="robot",
            stamp_ns=stamp_ns,
            ranges=ArrayBlob.of(ranges, "float32"),
            angle_min_rad=-1.5,
            angle_step_rad=0.05,
            range_max_m=20.0,
            robot_from_laser=(0.0, 0.0, 0.0),
        )
    )


def test_a_malformed_scan_is_counted_logged_once_and_dropped() -> None:
    with with_live_robot() as (tested, _):
        tested.wait_until_it_tracks()
        clusters, step = tested.clusters(), tested.step
        now_ns = time.time_ns()
        bad = [
            *NOT_MESSAGES.values(),
            reading(np.zeros(0), now_ns),  # empty
            reading(np.full(61, 50.0), now_ns),  # all out of range
            reading(np.full(61, np.nan), now_ns),  # not finite
            reading(np.full(61, 2.0), now_ns + 3_600 * 10**9),  # from the future
        ]
        for payload in bad * TIMES:
            tested.session.put(keys.LASER_READING, payload)
        # And straight to workers and coordinator, whom the bridge would protect.
        for payload in [*NOT_MESSAGES.values()] * TIMES:
            tested.session.put(keys.SCAN, payload)
        wait_until(lambda: len(tested.since(step)) > 15)
        assert not any(belief.missing for belief in tested.since(step)), "filters untouched"
        assert tested.clusters() == clusters
        with tested.client as client:
            wait_until(lambda: set(dropped_by(client.status(), "sensor_bridge")) >= MALFORMED)
            status = client.status()
        refused = dropped_by(status, "sensor_bridge")
        assert sum(n for cause, n in refused.items() if "malformed" in cause) <= 4 * TIMES
        assert status.counters["malformed Scan: not MessagePack"] == 3 * TIMES
        assert status.counters["malformed Scan: schema"] == TIMES
        minutes = (time.time_ns() - now_ns) / 60e9
        for cause in MALFORMED:
            assert 1 <= tested.log(BRIDGE).count(f"{cause}: ") <= 1 + minutes, "said once a minute"
        logged = tested.log(WORKERS).count("worker-0: malformed Scan: not MessagePack")
        assert 1 <= logged <= 1 + minutes
