"""docs/security.md: reports of one worker do not fill the coordinator's memory."""

import numpy as np
import psutil
import zenoh
from msgspec.structs import replace

from clustermcl.stack import COORDINATOR
from protocol import keys
from protocol.arrays import ArrayBlob
from protocol.codec import decode, encode
from protocol.work import Particles, Report, TrackReport
from tests.integration.faults.system import System, system
from tests.integration.waiting import wait_until

FLOOD = 40
PARTICLES = 1_000_000
"""The most that a message can carry: 32 MB."""


class Flooder:
    """Publishes reports in the name of a worker that tracks a cluster."""

    def __init__(self, tested: System) -> None:
        self._session = tested.session
        self._heard: dict[str, TrackReport] = {}
        tested.session.declare_subscriber(keys.ALL_REPORTS, self._on_report)
        wait_until(lambda: self._heard)
        self._key = min(self._heard)

    def _on_report(self, sample: zenoh.Sample) -> None:
        report: Report = decode(sample.payload.to_bytes(), Report)  # type: ignore[arg-type] # a union
        if isinstance(report, TrackReport):
            self._heard[str(sample.key_expr)] = report

    def report(self, step: int, snapshot: Particles | None = None) -> None:
        """Publish the worker's last report with another step and other particles."""
        report = replace(self._heard[self._key], step=step, snapshot=snapshot)
        block = zenoh.CongestionControl.BLOCK
        self._session.put(self._key, encode(report), congestion_control=block)


def resident_mb(tested: System) -> float:
    """Return the resident memory of the coordinator's process [MB]."""
    return float(psutil.Process(tested.pid(COORDINATOR)).memory_info().rss) / 1e6


def huge_cloud() -> Particles:
    poses = np.zeros((PARTICLES, 3))
    return Particles(
        step=0,
        odom_from_robot=(0.0, 0.0, 0.0),
        map_from_robot=ArrayBlob.of(poses, "float64"),
        log_weights=ArrayBlob.of(poses[:, 0], "float64"),
    )


def test_reports_of_steps_far_ahead_and_huge_snapshots_are_refused_and_not_kept() -> None:
    with system() as tested, tested.client as client:

        def counter(name: str) -> int:
            return client.status().counters.get(name, 0)

        tested.wait_until_it_tracks()
        flooder, before_mb, huge = Flooder(tested), resident_mb(tested), huge_cloud()
        for n in range(FLOOD):
            step = (tested.step if n % 2 else 1_000_000) + n
            flooder.report(step, replace(huge, step=step))
        for n in range(FLOOD):
            flooder.report(2_000_000 + n)
        wait_until(lambda: counter("report far ahead, or too many wait") >= FLOOD)
        assert counter("snapshot with too many particles") > 0
        wait_until(lambda: resident_mb(tested) - before_mb < 300.0)
        step = tested.step
        wait_until(lambda: tested.step > step + 10 and tested.tracks())
