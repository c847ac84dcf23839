"""What the flight recorder costs the coordinator's loop, and how much it writes.

A step of ten clusters on twelve workers: a scan, ten reports, five of odometry, a belief.
"""

import time
import weakref
from pathlib import Path

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from benchmarks.test_messages import COVARIANCE, MESSAGES, PARTICLES, POSE, RANGES, order
from clustermcl.coordinator.coordinator import Coordinator, Started
from clustermcl.coordinator.events import (
    Event,
    OdometryArrived,
    OrderAnswered,
    ReportArrived,
    ScanArrived,
    TimePassed,
    WorkerChanged,
    WorkerStateArrived,
)
from clustermcl.coordinator.instructions import AskState, Instruction, SendOrder
from clustermcl.coordinator.recorder.flight_recorder import FlightRecorder
from clustermcl.coordinator.recorder.records import freeze
from clustermcl.coordinator.recorder.ring import Ring, files_in
from clustermcl.filter.settings import BeliefSettings, FilterSettings, SearchSettings
from clustermcl.protocol.answers import Belief
from clustermcl.protocol.found_places import FoundPlaces
from clustermcl.protocol.steps import OdometryReading, Scan
from clustermcl.protocol.work import OrderAnswer, SearchReport, TrackReport, WorkerState
from clustermcl.runtime.settings import CoordinatorSettings

CLUSTERS, WORKERS = 10, 12
SNAPSHOT_EVERY = 10
STEP_NS = 500_000_000
"""Two steps a second."""
STARTED = Started(
    sender="coordinator",
    filter_settings=FilterSettings(
        search=SearchSettings(shards=1),
        belief=BeliefSettings(
            max_clusters=CLUSTERS,
            search_every_steps=10**9,
            kidnapping_probability=0.0,
        ),
    ),
    settings=CoordinatorSettings(),
    version="benchmark", now_ns=0, term=1, known=None,
)  # fmt: skip


class Run:
    """Well-behaved workers, and a coordinator that gets their reports by `handle`."""

    def __init__(self, folder: Path | None) -> None:
        self.coordinator: Coordinator = STARTED.coordinator()
        ring = Ring(folder, 1, 50_000_000) if folder else None
        if ring is not None:
            weakref.finalize(self, ring.close)
        self.recorder = FlightRecorder(self.coordinator, ring)
        self._rng = np.random.default_rng(1)
        self._epochs: dict[str, int] = {}
        self._places: dict[str, str] = {}
        self._step, self._now_ns = 0, 0
        self.beliefs = 0
        for number in range(WORKERS):
            self._apply(WorkerChanged(f"worker-{number}", "joined"))
        self._apply(ScanArrived(self._scan()))
        self._apply(ReportArrived(self._places["s0.0"], self._found()))
        assert len(self._epochs) == CLUSTERS + 1

    def events(self) -> list[Event]:
        """What happens in the next step."""
        self._step += 1
        reports = [self._tracked(f"c{number}") for number in range(CLUSTERS)]
        odometry = [
            OdometryArrived(
                OdometryReading(
                    sender="bridge", stamp_ns=self._stamp_ns() + part, odom_from_robot=self._pose()
                )
            )
            for part in range(5)
        ]
        ticks = [TimePassed()] * 5
        arrived = [ReportArrived(self._places[r.job_id], r) for r in reports]
        return [*odometry, *ticks, ScanArrived(self._scan()), *arrived]

    def apply(self, events: list[Event]) -> None:
        """A step as the loop passes it on."""
        for event in events:
            self._apply(event)

    def _apply(self, event: Event) -> None:
        self._now_ns += STEP_NS // 21
        self._follow(self.recorder.handle(event, self._now_ns))

    def _follow(self, instructions: list[Instruction]) -> None:
        for instruction in instructions:
            match instruction:
                case Belief():
                    self.beliefs += 1
                case AskState(worker=worker):
                    state = WorkerState(sender=worker, term=0, holds=())
                    self._apply(WorkerStateArrived(worker, state))
                case SendOrder(worker=worker, order=order):
                    for given in order.begin:
                        self._epochs[given.job_id] = given.epoch
                        self._places[given.job_id] = worker
                    jobs = (*order.keep, *((a.job_id, a.epoch) for a in order.begin))
                    answer = OrderAnswer(
                        sender=worker, order=order.order,
                        jobs=tuple((job_id, epoch, 0) for job_id, epoch in jobs),
                    )  # fmt: skip
                    self._apply(OrderAnswered(worker, answer))

    def _stamp_ns(self) -> int:
        return 10**18 + self._step * STEP_NS

    def _pose(self) -> tuple[float, float, float]:
        x, y, heading = self._rng.normal(size=3)
        return (float(x), float(y), float(heading))

    def _scan(self) -> Scan:
        return Scan(
            sender="bridge", step=self._step, stamp_ns=self._stamp_ns(),
            odom_from_robot=self._pose(), robot_from_laser=POSE, angle_min_rad=-1.5,
            angle_step_rad=0.01, range_max_m=30.0, ranges=RANGES, map_digest="0" * 64,
        )  # fmt: skip

    def _covariance(self) -> tuple[float, ...]:
        root = self._rng.normal(size=(3, 3))
        return tuple(float(v) for v in (root @ root.T).ravel())

    def _tracked(self, job_id: str) -> TrackReport:
        number = int(job_id[1:])
        due = self._step % SNAPSHOT_EVERY == number % SNAPSHOT_EVERY
        return TrackReport(
            sender=self._places[job_id], job_id=job_id, epoch=self._epochs[job_id],
            step=self._step, log_weight_sum=float(self._rng.normal()), particles=2_000,
            effective_sample_size=float(self._rng.uniform(100, 2_000)),
            pose=(10.0 * number, *self._pose()[1:]), covariance=self._covariance(),
            snapshot=PARTICLES if due else None,
        )  # fmt: skip

    def _found(self) -> SearchReport:
        poses = PARTICLES.map_from_robot.array()
        places = FoundPlaces.of(
            (0.0, 0.0, 0.0), np.full(CLUSTERS, 1.0 / CLUSTERS),
            [(10.0 * number, 0.0, 0.0) for number in range(CLUSTERS)],
            [COVARIANCE] * CLUSTERS, [poses] * CLUSTERS,
        )  # fmt: skip
        return SearchReport(
            sender="worker-0", job_id="s0.0", epoch=self._epochs["s0.0"], step=0, log_evidence=0.0,
            particles=100, left_out_gap=12.0, places=places,
        )  # fmt: skip


class Still:
    """A coordinator whose decisions cost nothing: a belief after a step's last report."""

    def __init__(self, believed: list[Instruction]) -> None:
        self._believed, self._reports = believed, 0

    def handle(self, event: Event, _: int) -> list[Instruction]:
        self._reports += isinstance(event, ReportArrived)
        return self._believed if self._reports % CLUSTERS == 0 else []


@pytest.mark.benchmark(timer=time.thread_time)
def test_handing_on_a_step(benchmark: BenchmarkFixture, tmp_path: Path) -> None:
    """The recorder's own work in the loop's thread: 21 events and a belief."""
    run = Run(None)
    events, orders = run.events(), [SendOrder("w", order())] * 3
    still = Still([*orders, MESSAGES["belief of 10 clusters"], MESSAGES["pose"]])
    recorder = FlightRecorder(still, Ring(tmp_path, 1, 50_000_000))
    recorder._begin_file = False  # a stub has no snapshot
    recorder._recording = True

    def apply() -> None:
        for event in events:
            recorder.handle(event, 0)

    benchmark.pedantic(apply, setup=recorder._queue.clear, rounds=2_000)


@pytest.mark.parametrize("recorded", [False, True], ids=["not recorded", "recorded"])
def test_a_step_of_the_coordinator(
    benchmark: BenchmarkFixture, tmp_path: Path, *, recorded: bool
) -> None:
    """The difference of the two is the cost in the loop's thread, and that of sharing Python."""
    run = Run(tmp_path if recorded else None)

    def setup() -> tuple[tuple[list[Event]], dict[str, object]]:
        time.sleep(0.01)  # steps do not come at once; the thread gets its turns
        return (run.events(),), {}

    with run.recorder.running():
        benchmark.pedantic(run.apply, setup=setup, rounds=300)
    assert run.beliefs >= (300 if benchmark.enabled else 1)
    assert run.recorder.lost == {}


def test_writing_a_step_down(benchmark: BenchmarkFixture, tmp_path: Path) -> None:
    """The work of the recorder's own thread for a step."""
    run = Run(tmp_path)
    benchmark.pedantic(
        run.recorder.flush, setup=lambda: run.apply(run.events()), rounds=500, iterations=1
    )
    before = _bytes_in(tmp_path)
    for _ in range(1_000):
        run.apply(run.events())
        run.recorder.flush()
    written = _bytes_in(tmp_path) - before
    benchmark.extra_info["bytes a step"] = written / 1_000
    benchmark.extra_info["MB an hour of 2 steps/s"] = written / 1_000 * 7_200 / 1e6
    assert written / 1_000 * 7_200 < 55e6


def test_a_snapshot(benchmark: BenchmarkFixture) -> None:
    """Once a file, in the loop's thread."""
    run = Run(None)
    for _ in range(20):
        run.apply(run.events())
    data = benchmark(freeze, run.coordinator)
    benchmark.extra_info["bytes"] = len(data)


def _bytes_in(folder: Path) -> int:
    return sum(file.stat().st_size for file in files_in(folder))
