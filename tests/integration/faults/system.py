"""A whole system under test, with a subscriber to all its messages and means to inject faults."""

import os
import signal
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from itertools import pairwise
from pathlib import Path
from typing import TypeVar

import psutil
import zenoh
from msgspec.structs import replace

from clustermcl.client import Client
from clustermcl.commands.stack import WORKERS, Stack, meeting_in
from clustermcl.filter.settings import BeliefSettings, ClusterSettings, SearchSettings
from clustermcl.link.session import open_session
from clustermcl.protocol import keys
from clustermcl.protocol.answers import Belief, PoseAnswer, Status
from clustermcl.protocol.codec import decode
from clustermcl.protocol.errors import MalformedMessageError
from clustermcl.protocol.job_events import JobEvent
from clustermcl.protocol.message import Message
from clustermcl.protocol.steps import Scan, ScanHistory
from clustermcl.runtime.settings import (
    BridgeSettings,
    CoordinatorSettings,
    Settings,
    WorkerSettings,
)
from clustermcl.runtime.stop import StopFlag
from clustermcl.runtime.supervisor import python_module
from tests.integration.processes import RunningProcess
from tests.integration.waiting import PATIENCE_S, answered, patient_client, wait_until

M = TypeVar("M", bound=Message)

SIMULATOR = "simulator"
SMALL = Settings(
    seed=3,
    cluster=ClusterSettings(particles=300),
    search=SearchSettings(poses=4_000, max_steps=20),
    belief=BeliefSettings(max_clusters=4, search_every_steps=100_000),
    bridge=BridgeSettings(source="sim:cross", rate=2.0),
    worker=WorkerSettings(count=4),
    coordinator=CoordinatorSettings(
        step_deadline_s=10.0, lockstep_deadline_s=60.0, search_deadline_s=10.0, stale_after_s=5.0
    ),
)
"""Four places that stay alike, one worker each, some five steps a second; no search meanwhile.

A busy machine misses no deadline, so no update is lost.
"""
IMPATIENT = replace(SMALL, coordinator=CoordinatorSettings())
"""With the deadlines of the product, for tests in which workers miss them."""


class System:
    def __init__(self, settings: Settings, stack: Stack, folder: Path, session: zenoh.Session):
        self.settings, self.stack, self.folder = settings, stack, folder
        self.session = session
        self._names = set(stack.supervisor.pids())
        self.started: list[RunningProcess] = []
        self.beliefs: list[Belief] = []
        self._received_ns: list[int] = []
        session.declare_subscriber(keys.BELIEF, self._on_belief)

    def _on_belief(self, sample: zenoh.Sample) -> None:
        with suppress(MalformedMessageError):  # of an intruder
            self.beliefs.append(decode(sample.payload.to_bytes(), Belief))
            self._received_ns.append(time.monotonic_ns())

    @property
    def client(self) -> Client:
        return Client(patient_client(self.settings))

    def status(self) -> Status:
        with self.client as client:
            return client.status()

    def pose(self) -> PoseAnswer:
        with self.client as client:
            return client.pose()

    def jobs(self) -> dict[str, tuple[str, ...]]:
        return dict(self.status().workers)

    def events(self, after_step: int = -1) -> list[JobEvent]:
        with self.client as client:
            return [one.event for one in client.events().events if one.step > after_step]

    def history(self) -> tuple[Scan, ...]:
        return answered(self.session, keys.scan_history(0, None), ScanHistory).scans

    def next_message(
        self, key: str, kind: type[M], is_wanted: Callable[[M], object] = lambda _: True
    ) -> M:
        received: list[M] = []
        subscriber = self.session.declare_subscriber(
            key, lambda sample: received.append(decode(sample.payload.to_bytes(), kind))
        )
        wait_until(lambda: received and is_wanted(received[-1]))
        subscriber.undeclare()
        return received[-1]

    @property
    def step(self) -> int:
        """The last step believed; -1 before the first."""
        return self.beliefs[-1].step if self.beliefs else -1

    def since(self, step: int) -> list[Belief]:
        return [belief for belief in list(self.beliefs) if belief.step > step]

    def gaps_s(self) -> list[float]:
        received = list(self._received_ns)
        return [(b - a) / 1e9 for a, b in pairwise(received)]

    def clusters(self) -> set[int]:
        return {h.cluster for h in self.beliefs[-1].hypotheses}

    def tracks(self) -> bool:
        """Whether clusters are tracked, as many as there are workers, and none is missing."""
        if not self.beliefs:
            return False
        last = self.beliefs[-1]
        return last.state != "searching" and not last.missing and not last.searching

    def wait_until_it_tracks(self) -> None:
        """Wait for clusters, and for the end of the decoy that accompanies each start."""
        wait_until(self.tracks)
        wait_until(lambda: {job[0] for jobs in self.jobs().values() for job in jobs} <= {"c", "e"})
        step = self.step
        wait_until(lambda: len(self.since(step)) >= 5 and self.tracks())

    def wait_for_steps(self, count: int, deadline_s: float = PATIENCE_S) -> None:
        step = self.step
        wait_until(lambda: self.step >= step + count, deadline_s)

    def wait_for_the_end(self) -> list[Belief]:
        """Wait for the simulated robot's last step, while all processes live; all beliefs."""

        def is_over() -> bool:
            self.stack.check()
            return bool(self.beliefs) and self.beliefs[-1].last

        wait_until(is_over, 2 * PATIENCE_S)
        return list(self.beliefs)

    def pid(self, name: str) -> int:
        return self.stack.supervisor.pids()[name]

    def worker_pids(self) -> list[int]:
        children = psutil.Process(self.pid(WORKERS)).children()
        return [child.pid for child in sorted(children, key=lambda child: child.create_time())]

    def start(self, module: str, *arguments: str) -> RunningProcess:
        """Start one process more, with the settings of all; it ends with the system."""
        words = ["--settings", str(self.folder / "settings.toml"), *arguments]
        name = f"more-{len(self.started)}"
        self.started.append(RunningProcess(python_module(module, *words), self.folder, name))
        return self.started[-1]

    def hurt(self, name: str, number: int = signal.SIGKILL) -> None:
        """Send a signal to a process of the stack; `mend` restarts a process that it ended."""
        os.kill(self.pid(name), number)

    def mend(self) -> None:
        def all_run() -> bool:
            self.stack.supervisor.poll(time.monotonic())
            return set(self.stack.supervisor.pids()) == self._names

        wait_until(all_run)

    def restart(self, name: str) -> None:
        """Kill a process of the stack; wait until another one runs in its place."""
        killed = self.pid(name)
        self.hurt(name)

        def is_replaced() -> bool:
            self.stack.supervisor.poll(time.monotonic())
            return self.stack.supervisor.pids().get(name, killed) != killed

        wait_until(is_replaced)

    def log(self, name: str) -> str:
        return (self.folder / f"{name}.log").read_text()


@contextmanager
def system(settings: Settings = SMALL, *arguments: str, endpoint: str = "") -> Iterator[System]:
    with ExitStack() as resources:
        folder = Path(resources.enter_context(tempfile.TemporaryDirectory(prefix="mcl-")))
        cache = replace(settings.worker, cache_folder=str(folder / "cache"))
        met = meeting_in(folder, replace(settings, worker=cache))
        if endpoint:
            zenoh_settings = replace(met.zenoh, router=endpoint)
            met = replace(met, zenoh=zenoh_settings)
        stack = Stack(met, folder, logs_in_folder=True, simulator_arguments=arguments)
        resources.enter_context(closing(stack))
        stack.start_all()
        session = resources.enter_context(
            open_session(met.zenoh, met.robot, StopFlag(), wait_s=PATIENCE_S)
        )
        tested = System(met, stack, folder, session)
        try:
            yield tested
        finally:
            for process in tested.started:
                process.kill()
