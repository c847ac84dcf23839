"""Scans as fast as the fastest lasers, every one a step: how long from a scan to its belief?

``python -m tests.integration.load.programs.scan_load --minutes 10`` prints the distributions.
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path

import msgspec
import numpy as np
import zenoh

from particle_filter.settings import BeliefSettings, SearchSettings
from process_runtime.settings import (
    BridgeSettings,
    CoordinatorSettings,
    Settings,
    WorkerSettings,
    ZenohSettings,
)
from process_runtime.stop import StopFlag
from protocol import keys
from protocol.answers import Belief, Status
from protocol.codec import decode
from protocol.steps import Scan
from robot_simulator.worlds.eight_rooms import PLACES
from tests.soak.fleet import Fleet
from zenoh_link.session import open_session
from zenoh_link.wire import ask

RATE_HZ = 40.0
SETTINGS = Settings(
    seed=1,
    search=SearchSettings(poses=20_000),
    belief=BeliefSettings(max_clusters=PLACES, search_every_steps=10**9),
    bridge=BridgeSettings(source="zenoh", gate_distance_m=0.0, gate_turn_rad=0.0),
    coordinator=CoordinatorSettings(state_folder="off"),
    worker=WorkerSettings(count=PLACES),
)
"""Eight rooms exactly alike: K = 8 clusters of the usual size, one a worker. Every scan a step."""
SETTLED_STEPS = 80
"""Steps with all clusters and nothing missing before anything is measured."""
START_WITHIN_S = 120.0


@dataclass
class Measured:
    """Messages received during the measurement."""

    steps: int = 0
    lost: int = 0
    """Steps without a belief."""
    without_all: int = 0
    """Beliefs that had to do without some cluster's report."""
    clusters: int = 0
    """Of the last belief."""
    scan_to_belief_s: list[float] = field(default_factory=list)
    """From the step's message to its belief's, both as one subscriber received them."""
    laser_to_belief_s: list[float] = field(default_factory=list)
    """From the laser's own stamp: besides, the wait for the odometry after the scan."""

    def table(self) -> str:
        """A line each for the two delays, and one for the steps."""
        lines = [
            f"{self.steps} steps, {self.lost} lost, {self.without_all} without all reports, "
            f"{self.clusters} clusters"
        ]
        for name in ("scan_to_belief_s", "laser_to_belief_s"):
            shares = (50.0, 90.0, 99.0, 99.9, 100.0)
            values = np.percentile(getattr(self, name), shares) * 1e3
            said = "  ".join(f"p{s:g} {v:.1f}" for s, v in zip(shares, values, strict=True))
            lines.append(f"{name.removesuffix('_s').replace('_', ' ')} [ms]: {said}")
        return "\n".join(lines)


class Listener:
    """Hears every scan and every belief, and when."""

    def __init__(self, session: zenoh.Session) -> None:
        self.scans: dict[int, int] = {}
        self.beliefs: dict[int, tuple[int, int, Belief]] = {}
        session.declare_subscriber(keys.SCAN, self._on_scan)
        session.declare_subscriber(keys.BELIEF, self._on_belief)

    def _on_scan(self, sample: zenoh.Sample) -> None:
        now_ns = time.monotonic_ns()
        self.scans.setdefault(decode(sample.payload.to_bytes(), Scan).step, now_ns)

    def _on_belief(self, sample: zenoh.Sample) -> None:
        now_ns, wall_ns = time.monotonic_ns(), time.time_ns()
        belief = decode(sample.payload.to_bytes(), Belief)
        self.beliefs[belief.step] = (now_ns, wall_ns, belief)

    def settled(self) -> bool:
        """Whether all clusters have been tracked for a while."""
        last = [belief for _, _, belief in list(self.beliefs.values())[-SETTLED_STEPS:]]
        return len(last) == SETTLED_STEPS and all(
            len(b.hypotheses) == PLACES and not (b.missing or b.searching) for b in last
        )

    def between(self, first: int, last: int) -> Measured:
        """Measurements of some steps."""
        measured = Measured(steps=last - first + 1)
        for step in range(first, last + 1):
            if step not in self.beliefs:
                measured.lost += 1
                continue
            heard_ns, wall_ns, belief = self.beliefs[step]
            measured.without_all += bool(belief.missing)
            measured.clusters = len(belief.hypotheses)
            measured.laser_to_belief_s.append((wall_ns - belief.stamp_ns) / 1e9)
            if step in self.scans:
                measured.scan_to_belief_s.append((heard_ns - self.scans[step]) / 1e9)
        return measured


def run_load(
    duration_s: float,
    folder: Path,
    rate_hz: float = RATE_HZ,
    beside: Callable[[], AbstractContextManager[None]] = nullcontext,
) -> tuple[Measured, Status]:
    """Run the whole stack under load and measure.

    Args:
        duration_s: of the measurement.
        folder: for everything.
        rate_hz: scans a second.
        beside: what else the machine does while it is measured.

    Raises:
        TimeoutError: the clusters were not found and tracked without misses in time.
    """
    router = ZenohSettings(router=f"unixsock-stream/{folder}/router.sock")
    worker = msgspec.structs.replace(SETTINGS.worker, cache_folder=str(folder / "cache"))
    settings = msgspec.structs.replace(SETTINGS, zenoh=router, worker=worker)
    fleet = Fleet(
        [settings], folder, world="eight_rooms", rate_hz=rate_hz, coordinators=1, cables=False
    )
    fleet.start()
    try:
        with open_session(router, settings.robot, StopFlag(), wait_s=30.0) as session:
            listener = Listener(session)
            _wait(listener.settled, START_WITHIN_S, fleet)
            first = max(listener.beliefs) + 1
            with beside():
                _wait(lambda: False, duration_s, fleet, raises=False)
            last = max(listener.beliefs)
            return listener.between(first, last), ask(session, keys.STATUS, Status, timeout_s=5.0)
    finally:
        fleet.stop()


def _wait(
    condition: Callable[[], bool], at_most_s: float, fleet: Fleet, *, raises: bool = True
) -> None:
    until_s = time.monotonic() + at_most_s
    while not condition():
        if time.monotonic() >= until_s:
            if raises:
                raise TimeoutError(f"not settled within {at_most_s:g} s")
            return
        fleet.poll()
        time.sleep(0.1)


def main() -> int:
    """Run; exit code 1 if a step was lost or beliefs came later than the next scan."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--rate-hz", type=float, default=RATE_HZ)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="mcl-") as folder:
        measured, status = run_load(arguments.minutes * 60.0, Path(folder), arguments.rate_hz)
    print(measured.table())
    print(f"status: {status.steps_lost} steps lost, {status.counters}")
    p99_s = float(np.percentile(measured.scan_to_belief_s, 99.0))
    return 1 if measured.lost or status.steps_lost or p99_s >= 1.0 / arguments.rate_hz else 0


if __name__ == "__main__":
    sys.exit(main())
