"""A whole system without processes: real workers' jobs, a bridge's history, and one coordinator.

What is sent is carried over as bytes. The coordinator may be thrown away between any two of its
instructions, and rebuilt from what the workers know.
"""

from collections import deque
from collections.abc import Callable

import msgspec
import numpy as np

from coordinator.coordinator import Coordinator
from coordinator.events import (
    CommandArrived,
    HistoryArrived,
    OrderAnswered,
    ReportArrived,
    ScanArrived,
    TimePassed,
    WorkerJoined,
    WorkerLeft,
    WorkerToldState,
)
from coordinator.failover.state_recovery import told_by
from coordinator.instructions import (
    AskState,
    FetchScans,
    Instruction,
    PublishBelief,
    PublishCheckpoint,
    SendOrder,
)
from coordinator.recorder.records import Started
from particle_filter.arrays import OCCUPIED
from particle_filter.likelihood_field import LikelihoodField
from particle_filter.ray_casting import jump_field
from particle_filter.sensor_model import SensorModel
from particle_filter.settings import (
    BeliefSettings,
    ClusterSettings,
    FilterSettings,
    SearchSettings,
    SensorSettings,
)
from process_runtime.settings import CoordinatorSettings
from protocol.answers import Belief, SetPose
from protocol.arrays import ArrayBlob
from protocol.codec import decode, encode
from protocol.errors import OldTermError
from protocol.steps import Scan
from protocol.work import (
    Checkpoint,
    OrderAnswer,
    Report,
    TrackReport,
    WorkerState,
    WorkOrder,
)
from worker.job_table import JobTable
from worker.term_fence import TermFence

SETTINGS = FilterSettings(
    seed=5,
    sensor=SensorSettings(visibility_particles=0),
    cluster=ClusterSettings(particles=60),
    search=SearchSettings(
        min_start_particles=600,
        max_start_particles=600,
        particles=200,
        shards=2,
        annealing_steps=2,
        max_steps=4,
        hand_over_particles=50,
    ),
    belief=BeliefSettings(clusters=4, search_every_steps=6, newcomer_min_share=0.01, grace_steps=2),
)
EVENT_NS = 1_000_000


def symmetric_room() -> SensorModel:
    """Two halves that look the same: several places stay possible."""
    cells = np.zeros((50, 60), np.int8)
    cells[[0, -1], :] = cells[:, [0, -1]] = OCCUPIED
    cells[20:30, 10:14] = cells[20:30, -14:-10] = OCCUPIED
    field = LikelihoodField.build(cells, 0.1, np.zeros(3), SETTINGS.sensor)
    return SensorModel(field, jump_field(cells), SETTINGS.sensor)


def scan_of(step: int) -> Scan:
    """What a robot on its way sees; with a pinch of noise, so that no two scans are alike."""
    rng = np.random.default_rng(step)
    ranges = 1.5 + 0.8 * np.sin(np.arange(24) / 3.0 + 0.2 * step) + rng.normal(0.0, 0.05, 24)
    return Scan(
        sender="bridge",
        step=step,
        stamp_ns=step * 1_000_000_000,
        odom_from_robot=(0.1 * step, 0.02 * step, 0.05 * step),
        robot_from_laser=(0.0, 0.0, 0.0),
        angle_min_rad=-3.0,
        angle_step_rad=0.25,
        range_max_m=20.0,
        ranges=ArrayBlob.of(ranges, "float32"),
        map_digest="map",
    )


class InMemoryWorker:
    """A worker's loop without a network."""

    def __init__(self, name: str, model: SensorModel, history: Callable[[int], list[Scan]]) -> None:
        self.name, self._model, self._history = name, model, history
        self.table, self.term_fence = JobTable(name), TermFence()
        self.reports: list[Report] = []

    def scan(self, scan: Scan) -> list[Report]:
        return self._said(self.table.on_scan(scan))

    def order(self, payload: bytes) -> tuple[OrderAnswer, list[Report]]:
        order = decode(payload, WorkOrder)
        problem, reports = "", []
        try:
            if self.term_fence.check(order):
                self.table.follow(order, self._model, SETTINGS)
                self.term_fence.order = order.order
        except (OldTermError, ValueError) as error:
            problem = str(error)
        else:
            missing = self.table.missing()
            reports = self.table.catch_up(self._history(missing.first) if missing else ())
        answer = OrderAnswer(
            sender=self.name,
            order=self.term_fence.order,
            incarnation=1,
            jobs=self.table.summary(),
            problem=problem,
            term=self.term_fence.term,
        )
        return answer, self._said(reports)

    def state(self, term: int) -> bytes:
        self.term_fence.hear(term)
        state = WorkerState(
            sender=self.name,
            term=self.term_fence.term,
            incarnation=1,
            holds=self.table.holds(),
            checkpoint=self.term_fence.checkpoint,
            reports=tuple(map(encode, self.table.reports_since(self.term_fence.step))),
        )
        return encode(state)

    def _said(self, reports: list[Report]) -> list[Report]:
        self.reports += reports
        return reports


class Living:
    """Everything of one robot; events run one after the other."""

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
        self.dies_in: int | None = None
        """Instructions until the coordinator dies; None: it lives."""
        self.coordinator: Coordinator | None = None
        self.workers = {f"w{n}": self._worker(f"w{n}") for n in range(workers)}
        self.revive()

    def _worker(self, name: str) -> InMemoryWorker:
        return InMemoryWorker(
            name, self._model, lambda first: [s for s in self.scans if s.step >= first]
        )

    def revive(self) -> None:
        """Start a coordinator that knows nothing."""
        self._term += 1
        started = Started(
            sender="coordinator",
            filter_settings=SETTINGS,
            settings=CoordinatorSettings(),
            version="test",
            now_ns=self._now_ns,
            term=self._term,
            known=None,
            last_poses={},
            live=False,
        )
        self.coordinator = self._made(started)
        for worker in list(self.workers):
            self._tell(lambda c, now, w=worker: c.handle(WorkerJoined(w), now))  # type: ignore[misc] # a default
        self._tell(lambda c, now: c.handle(TimePassed(), now))
        self.settle()

    def drive(self, step: int, *, stamp_ns: int | None = None) -> None:
        """One step: its scan reaches the workers, and the coordinator if it lives."""
        scan = scan_of(step)
        if stamp_ns is not None:
            scan = msgspec.structs.replace(scan, stamp_ns=stamp_ns)
        self.scans.append(scan)
        self._tell(lambda c, now: c.handle(ScanArrived(scan), now))
        for worker in self.workers.values():
            self._report(worker, worker.scan(scan))
        self.settle()

    def kill_worker(self, name: str) -> None:
        """A worker is gone at once, with all that it knew."""
        del self.workers[name]
        self._tell(lambda c, now: c.handle(WorkerLeft(name), now))
        self.settle()

    def start_worker(self, name: str) -> None:
        """A new worker appears."""
        self.workers[name] = self._worker(name)
        self.join(name)

    def join(self, name: str) -> None:
        """A worker is seen by the coordinator."""
        self._tell(lambda c, now: c.handle(WorkerJoined(name), now))
        self.settle()

    def command(self, command: SetPose) -> None:
        """A person asks for something."""
        self._tell(lambda c, now: c.handle(CommandArrived(command), now))
        self.settle()

    def wait(self, seconds: float) -> None:
        """Time passes."""
        self._now_ns += int(seconds * 1e9)
        self._tell(lambda c, now: c.handle(TimePassed(), now))
        self.settle()

    def settle(self) -> None:
        """Let everything come to rest."""
        while self._queue:
            self._queue.popleft()()

    def _tell(self, event: Callable[[Coordinator, int], list[Instruction]]) -> None:
        def happen() -> None:
            self._now_ns += EVENT_NS
            if self.coordinator is not None:
                self._follow(event(self.coordinator, self._now_ns))

        self._queue.append(happen)

    def _follow(self, instructions: list[Instruction]) -> None:
        for instruction in instructions:
            if self.dies_in is not None:
                self.dies_in -= 1
                if self.dies_in < 0:
                    self.coordinator, self.dies_in = None, None
                    return
            self._carry_out(instruction)

    def _carry_out(self, instruction: Instruction) -> None:
        match instruction:
            case PublishBelief(belief=belief):
                self.beliefs.setdefault(belief.step, []).append(decode(encode(belief), Belief))
            case PublishCheckpoint(checkpoint=checkpoint):
                payload = encode(checkpoint)
                for worker in self.workers.values():
                    worker.term_fence.keep(decode(payload, Checkpoint), payload)
            case FetchScans(first=first, last=last):
                end = 2**60 if last is None else last
                found = [s for s in self.scans if first <= s.step <= end]
                self._tell(lambda c, now: c.handle(HistoryArrived(tuple(found)), now))
            case AskState(worker=name, question=question):
                if name in self.workers:
                    told = told_by(self.workers[name].state(question.term))
                    self._tell(lambda c, now: c.handle(WorkerToldState(name, told), now))
            case SendOrder(worker=name, order=order):
                if name in self.workers:
                    answer, reports = self.workers[name].order(encode(order))
                    self._tell(lambda c, now: c.handle(OrderAnswered(name, answer), now))
                    self._tell(lambda c, now: c.handle(TimePassed(), now))
                    self._report(self.workers[name], reports)

    def _report(self, worker: InMemoryWorker, reports: list[Report]) -> None:
        for report in reports:
            copy: Report = decode(encode(report), Report)  # type: ignore[arg-type] # a union
            self._tell(lambda c, now, r=copy: c.handle(ReportArrived(worker.name, r), now))  # type: ignore[misc] # a default

    def particles(self) -> dict[str, bytes]:
        """The particles of each tracked cluster, as they are now."""
        return {
            held.job_id: held.job.start.map_from_robot.data
            for worker in self.workers.values()
            for held in worker.table.holds()
            if held.job_id.startswith("c")
        }

    def evidence(self) -> dict[tuple[str, int], set[float]]:
        """What was said of each cluster at each step, by anybody."""
        said: dict[tuple[str, int], set[float]] = {}
        for worker in self.workers.values():
            for report in worker.reports:
                if isinstance(report, TrackReport):
                    said.setdefault((report.job_id, report.step), set()).add(report.log_weight_sum)
        return said
