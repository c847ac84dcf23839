"""A whole system without processes: workers, a bridge's map and history, and one coordinator.

Messages are passed on as bytes. The coordinator may be thrown away between any two of its
instructions, and made again from the file that it left and what the workers know.
"""

from collections import deque
from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from msgspec.structs import replace

from clustermcl.coordinator import events
from clustermcl.coordinator import instructions as do
from clustermcl.coordinator.coordinator import Coordinator, Started
from clustermcl.coordinator.report_checks import without_malformed_jobs
from clustermcl.filter.arrays import OCCUPIED
from clustermcl.filter.grid import Grid
from clustermcl.filter.laser.sensor_model import SensorModel, computed_model
from clustermcl.filter.settings import (
    BeliefSettings,
    ClusterSettings,
    FilterSettings,
    SearchSettings,
)
from clustermcl.protocol import work
from clustermcl.protocol.answers import Belief, SetPose
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.codec import decode, encode
from clustermcl.protocol.live_settings import AS_STARTED
from clustermcl.protocol.steps import MapMessage, Scan
from clustermcl.runtime.settings import CoordinatorSettings
from clustermcl.worker import worker as worker_instructions
from clustermcl.worker.worker import Worker
from tests.unit.coordinator.reports import free_everywhere, scan, started

SETTINGS = FilterSettings(
    seed=5,
    cluster=ClusterSettings(particles=60),
    search=SearchSettings(
        heading_step_rad=0.2, poses=400, shards=2, max_steps=4, hand_over_particles=15, places=8
    ),
    belief=BeliefSettings(max_clusters=4, search_every_steps=6, candidate_probability=0.05),
)
WorkerEvent: TypeAlias = Callable[[Worker], list[worker_instructions.Instruction]]
EVENT_NS = 1_000_000
NO_COORDINATOR = work.TakeOver(sender="coordinator", term=0)
MAP = MapMessage(
    sender="bridge", digest="map", cell_m=0.1, map_from_grid=(0.0, 0.0, 0.0), rows=1, cols=1,
    zlib_cells=b"",
)  # fmt: skip
"""Stands for the symmetric room's."""


def symmetric_room() -> SensorModel:
    """Two halves that look the same: several places stay possible."""
    cells = np.zeros((50, 60), np.int8)
    cells[[0, -1], :] = cells[:, [0, -1]] = OCCUPIED
    cells[20:30, 10:14] = cells[20:30, -14:-10] = OCCUPIED
    return computed_model(Grid(cells, 0.1, np.zeros(3)), SETTINGS.sensor)


def scan_of(step: int) -> Scan:
    """What a robot on its way sees; with a pinch of noise, so that no two scans are alike."""
    rng = np.random.default_rng(step)
    ranges = 1.5 + 0.8 * np.sin(np.arange(24) / 3.0 + 0.2 * step) + rng.normal(0.0, 0.05, 24)
    return scan(
        step,
        odom_from_robot=(0.1 * step, 0.02 * step, 0.05 * step),
        angle_min_rad=-3.0,
        angle_step_rad=0.25,
        range_max_m=20.0,
        ranges=ArrayBlob.of(ranges, "float32"),
    )


class Living:
    def __init__(
        self,
        model: SensorModel,
        workers: int = 3,
        made: Callable[[Started], Coordinator] = Started.coordinator,
    ) -> None:
        self._made = made
        self.scans: list[Scan] = []
        self.beliefs: dict[int, list[Belief]] = {}
        self._model, self._now_ns, self._term = model, 0, 0
        self._queue: deque[Callable[[], None]] = deque()
        self.file: bytes | None = None
        """The checkpoint that outlives the coordinator."""
        self.dies_in: int | None = None
        """Instructions until the coordinator dies; None: it lives."""
        self.coordinator: Coordinator | None = None
        self.map_digest = MAP.digest
        """Of the bridge's map; of another one when it has been restarted with it."""
        self.live = AS_STARTED
        self.warnings: list[str] = []
        """Causes that workers have counted."""
        self.workers = {f"w{n}": Worker(f"w{n}") for n in range(workers)}
        self.revive()

    def revive(self, known: work.Checkpoint | None = None) -> None:
        """Start a coordinator with its state file and the checkpoints that it received as
        follower."""
        self._term += 1
        self.coordinator = self._made(
            started(
                filter_settings=SETTINGS,
                settings=CoordinatorSettings(search_deadline_s=20.0),
                now_ns=self._now_ns,
                term=self._term,
                known=known,
                kept=self.kept,
            )
        )
        for worker in list(self.workers):
            self._handle(events.WorkerChanged(worker, "joined"))
        self._handle(events.TimePassed())
        self.settle()

    @property
    def kept(self) -> work.Checkpoint | None:
        return decode(self.file, work.Checkpoint) if self.file else None

    def _keep(self, checkpoint: work.Checkpoint) -> None:
        kept = self.kept
        if kept is None or checkpoint.rank > kept.rank:
            self.file = encode(checkpoint)

    def drive(self, step: int, *, stamp_ns: int | None = None, like: int | None = None) -> None:
        """One step: its scan reaches the workers, and the coordinator if it lives."""
        shown = scan_of(step if like is None else like)
        scan = replace(shown, step=step, map_digest=self.map_digest, settings=self.live)
        if stamp_ns is not None:
            scan = replace(scan, stamp_ns=stamp_ns)
        self.scans.append(scan)
        self._handle(events.ScanArrived(scan))
        for worker in list(self.workers):
            self.deliver_to_worker(worker, lambda one: one.on_scan(scan))
        self.settle()

    def drive_on(self, until: int) -> "Living":
        for step in range(len(self.scans), until):
            self.drive(step)
        return self

    def kill_worker(self, name: str) -> None:
        del self.workers[name]
        self._handle(events.WorkerChanged(name, "left"))
        self.settle()

    def start_worker(self, name: str) -> None:
        self.workers[name] = Worker(name)
        self.join(name)

    def join(self, name: str) -> None:
        self._handle(events.WorkerChanged(name, "joined"))
        self.settle()

    def command(self, command: SetPose) -> None:
        self._handle(events.CommandArrived(command))
        self.settle()

    def wait(self, seconds: float) -> None:
        self._now_ns += int(seconds * 1e9)
        self._handle(events.TimePassed())
        self.settle()

    def settle(self) -> None:
        while self._queue:
            self._queue.popleft()()

    def _handle(self, event: events.Event) -> None:
        self._queue.append(lambda: self._handle_now(event))

    def _handle_now(self, event: events.Event) -> None:
        self._now_ns += EVENT_NS
        if self.coordinator is not None:
            self._follow(self.coordinator.handle(event, self._now_ns))

    def _map_arrives(self) -> None:
        """That of the digest which the coordinator knows by then."""
        digest = self.coordinator.state.map_digest if self.coordinator else ""
        self._handle_now(events.MapArrived(free_everywhere(digest)))

    def _follow(self, instructions: list[do.Instruction]) -> None:
        for instruction in instructions:
            if self.dies_in is not None:
                self.dies_in -= 1
                if self.dies_in < 0:
                    self.coordinator, self.dies_in = None, None
                    return
            self._carry_out(instruction)

    def _carry_out(self, instruction: do.Instruction) -> None:
        match instruction:
            case Belief(step=step):
                self.beliefs.setdefault(step, []).append(decode(encode(instruction), Belief))
            case work.Checkpoint():
                self._keep(instruction)
                payload = encode(instruction)
                received = decode(payload, work.Checkpoint)
                for worker in self.workers:
                    self.deliver_to_worker(worker, lambda one: one.on_checkpoint(received))
            case do.FetchScans(first=first, last=last):
                found = self._history(first, last)
                self._handle(events.HistoryArrived(found))
            case do.FetchMap():
                self._queue.append(self._map_arrives)
            case do.AskState(worker=name, question=question):
                if name in self.workers:
                    stated = without_malformed_jobs(
                        decode(encode(self.state(name, question)), work.WorkerState)
                    )
                    self._handle(events.WorkerStateArrived(name, stated))
            case do.SendOrder(worker=name, order=order):
                if name in self.workers:
                    copy = decode(encode(order), work.WorkOrder)
                    self.deliver_to_worker(name, lambda worker: worker.on_order(None, copy))

    def _history(self, first: int, last: int | None) -> tuple[Scan, ...]:
        end = 2**60 if last is None else last
        return tuple(scan for scan in self.scans if first <= scan.step <= end)

    def deliver_to_worker(self, name: str, event: WorkerEvent) -> None:
        """Something happens to a worker; what comes of it happens in its turn."""
        worker = self.workers[name]
        instructions = event(worker)
        while worker.searches:
            instructions += worker.search()
        for instruction in instructions:
            self._carry_out_for(name, instruction)

    def _carry_out_for(self, name: str, instruction: worker_instructions.Instruction) -> None:
        match instruction:
            case worker_instructions.Answer(message=work.OrderAnswer() as answer):
                self._handle(events.OrderAnswered(name, answer))
                self._handle(events.TimePassed())
            case worker_instructions.FetchMap():
                stated = replace(MAP, digest=self.map_digest)
                self._deliver_later(name, lambda worker: worker.on_map(stated))
            case worker_instructions.BuildModel(settings=settings):
                if settings != self._model.settings:
                    self._model = computed_model(self._model.grid, settings)
                digest, model = instruction.map.digest, self._model
                self._deliver_later(name, lambda worker: worker.on_model(digest, model))
            case worker_instructions.FetchScans(missing):
                scans = self._history(missing.first, missing.last)
                self._deliver_later(name, lambda worker: worker.on_history(missing, scans))
            case worker_instructions.Warn(cause):
                self.warnings.append(cause)
            case worker_instructions.Answer() | worker_instructions.Advise():
                pass
            case report:
                self._handle(events.ReportArrived(name, decode(encode(report), type(report))))

    def _deliver_later(self, name: str, event: WorkerEvent) -> None:
        def happen() -> None:
            if name in self.workers:
                self.deliver_to_worker(name, event)

        self._queue.append(happen)

    def state(self, name: str, take_over: work.TakeOver = NO_COORDINATOR) -> work.WorkerState:
        (answer,) = self.workers[name].on_take_over(None, take_over)
        assert isinstance(answer.message, work.WorkerState)
        return answer.message

    def particles(self) -> dict[str, bytes]:
        return {
            held.job_id: held.job.start.map_from_robot.data
            for worker in self.workers
            for held in self.state(worker).holds
            if isinstance(held.job, work.TrackJob)
        }
