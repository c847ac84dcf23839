"""Scans at 40 Hz, every one a step, eight clusters: no step lost, beliefs before the next scan."""

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path

import msgspec
import numpy as np
import pytest
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
from tests.integration.waiting import PATIENCE_S, wait_until
from tests.soak.eight_rooms import PLACES
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


class Listener:
    """Records scans and beliefs with the times of their receipt.

    Args:
        session: of the robot.
    """

    def __init__(self, session: zenoh.Session) -> None:
        self._scans_ns: dict[int, int] = {}
        self.beliefs: dict[int, tuple[int, Belief]] = {}
        """Time of receipt [ns] and belief of each step."""
        session.declare_subscriber(keys.SCAN, self._on_scan)
        session.declare_subscriber(keys.BELIEF, self._on_belief)

    def _on_scan(self, sample: zenoh.Sample) -> None:
        now_ns = time.monotonic_ns()
        self._scans_ns.setdefault(decode(sample.payload.to_bytes(), Scan).step, now_ns)

    def _on_belief(self, sample: zenoh.Sample) -> None:
        now_ns, belief = time.monotonic_ns(), decode(sample.payload.to_bytes(), Belief)
        self.beliefs[belief.step] = now_ns, belief

    def settled(self) -> bool:
        """Whether all clusters have been tracked for a while."""
        last = [belief for _, belief in list(self.beliefs.values())[-SETTLED_STEPS:]]
        return len(last) == SETTLED_STEPS and all(
            len(b.hypotheses) == PLACES and not (b.missing or b.searching) for b in last
        )

    def delays_s(self, steps: range) -> list[float]:
        """Times from the scans of these steps to their beliefs [s]."""
        return [
            (self.beliefs[step][0] - self._scans_ns[step]) / 1e9
            for step in steps
            if step in self._scans_ns
        ]


def delays_under_load(
    duration_s: float,
    folder: Path,
    other_load: Callable[[], AbstractContextManager[None]] = nullcontext,
) -> list[float]:
    """Run all processes under load; no step may be lost, and all clusters are kept.

    Args:
        duration_s: of the measurement.
        folder: for everything.
        beside: what else the machine does while it is measured.

    Returns:
        Times from a scan to its belief [s].
    """
    router = ZenohSettings(router=f"unixsock-stream/{folder}/router.sock")
    worker = msgspec.structs.replace(SETTINGS.worker, cache_folder=str(folder / "cache"))
    settings = msgspec.structs.replace(SETTINGS, zenoh=router, worker=worker)
    fleet = Fleet(
        [settings], folder, world="eight_rooms", rate_hz=RATE_HZ, coordinators=1, cables=False
    )
    fleet.start()

    def after_a_poll(condition: Callable[[], bool]) -> bool:
        fleet.poll()
        return condition()

    try:
        with open_session(router, settings.robot, StopFlag(), wait_s=PATIENCE_S) as session:
            listener = Listener(session)
            wait_until(lambda: after_a_poll(listener.settled), 120.0)
            first, until_s = max(listener.beliefs) + 1, time.monotonic() + duration_s
            with other_load():
                wait_until(lambda: after_a_poll(lambda: time.monotonic() > until_s), 2 * duration_s)
            steps = range(first, max(listener.beliefs) + 1)
            assert set(steps) <= listener.beliefs.keys(), "a step was lost"
            assert len(listener.beliefs[steps[-1]][1].hypotheses) == PLACES
            assert ask(session, keys.STATUS, Status, timeout_s=PATIENCE_S).steps_lost == 0
            return listener.delays_s(steps)
    finally:
        fleet.stop()


@contextmanager
def other_work(processes: int) -> Iterator[None]:
    """Keep the machine busy with other work."""
    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(processes)]
    try:
        yield
    finally:
        for one in busy:
            one.kill()
            one.wait()


@pytest.mark.soak
@pytest.mark.timeout(1200)
def test_ten_minutes_at_forty_hertz_lose_no_step_and_beliefs_come_before_the_next_scan(
    short_folder: str,
) -> None:
    delays_s = delays_under_load(600.0, Path(short_folder))
    assert np.percentile(delays_s, 99.0) < 1.0 / RATE_HZ


def test_some_seconds_at_forty_hertz_under_other_load_lose_no_step(short_folder: str) -> None:
    """An overloaded bridge makes fewer steps of the scans; the delay of a belief is not checked."""
    assert delays_under_load(8.0, Path(short_folder), other_load=lambda: other_work(4))
