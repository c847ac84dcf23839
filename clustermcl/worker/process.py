"""The worker process: one parent that compiles the kernels, and children that run the jobs.

The children of a pool serve several robots, each in a thread of its own with its own session, so
that robots share no state, and the operating system divides the cores fairly among them.
"""

import argparse
import logging
import os
import time
from collections.abc import Iterable, Sequence
from concurrent.futures import Future
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import TypeVar

from clustermcl.filter.laser.sensor_model import SensorModel
from clustermcl.filter.search.branch_and_bound import free_leaves
from clustermcl.filter.settings import FilterSettings, SensorSettings
from clustermcl.jobs.map_model import sensor_model
from clustermcl.jobs.warm_up import compile_kernels
from clustermcl.link.node import Node
from clustermcl.link.tls import check_files
from clustermcl.link.wire import Asked, Received
from clustermcl.protocol import keys
from clustermcl.protocol.advice import AdviceQuestion
from clustermcl.protocol.codec import decode
from clustermcl.protocol.conversion import prepare
from clustermcl.protocol.errors import (
    ClusterMclError,
    MalformedMessageError,
    SettingsError,
    UnreachableError,
)
from clustermcl.protocol.steps import MapMessage, Scan, ScanHistory
from clustermcl.protocol.work import (
    Checkpoint,
    Report,
    TakeOver,
    WorkOrder,
    check_term,
    in_few_messages,
)
from clustermcl.recordings.maps.map_message import from_message
from clustermcl.runtime.folders import kept_folder
from clustermcl.runtime.main import Invocation, process_main
from clustermcl.runtime.settings import Settings
from clustermcl.runtime.settings_file import load_settings
from clustermcl.runtime.stop import StopFlag
from clustermcl.runtime.supervisor import (
    ChildCount,
    ReportJobs,
    run_forked,
    work_without_preempting,
)
from clustermcl.runtime.threads import restarted, run_in_threads
from clustermcl.worker import worker as do
from clustermcl.worker.adviser import Adviser
from clustermcl.worker.search_queue import SearchPause
from clustermcl.worker.worker import Instruction, Worker

SPARE = 1
"""Least number of workers beyond one, so that another continues at once if one dies."""
KEPT_SCANS = 64
KEPT_CHECKPOINTS = 4
"""Number of checkpoints kept between two polls; two coordinators publish during a take-over."""
SCANS_PER_POLL = 2
"""Number of scans handled between two polls of checkpoints. A poll reads all that have arrived,
which is cheaper than waking up for each."""
POLL_S = 0.25
"""Longest wait for a message, after which the stop flag is checked [s]."""
PAUSE_S = 0.004
"""Longest wait for a message while searches pause for an undecided step [s]."""
MAP_TIMEOUT_S = 30.0
REPEAT_FOR_S = 0.5
"""Time for which a query for past scans is repeated: a new link has no route yet [s]."""

_log = logging.getLogger(__name__)

T = TypeVar("T", WorkOrder, TakeOver, Checkpoint)

_RECEIVED = WorkOrder, TakeOver, Checkpoint, AdviceQuestion, MapMessage, Scan, ScanHistory


def main() -> None:
    describe = "Workers of Cluster-MCL: each tracks a cluster of particles or searches."
    process_main("worker", run_workers, describe=describe, add_arguments=_add_arguments)


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("--count", type=int, metavar="N", help="worker processes (default: worker.count)")
    add("--fleet", type=Path, metavar="FOLDER", help="serve the robot of each settings file in it")


def run_workers(invocation: Invocation) -> None:
    """Compile the kernels, fork the workers, and keep them running until the process is stopped."""
    settings, prefix = invocation.settings, invocation.process
    folder, overrides = invocation.arguments.fleet, invocation.arguments.set
    fleet = None if folder is None else Fleet(folder, overrides)
    cache = kept_folder("maps", settings.worker.cache_folder)
    compile_kernels(SensorSettings())
    prepare(FilterSettings, *_RECEIVED)  # once for all children, and before they have threads

    def child(index: int, stop: StopFlag, report_jobs: ReportJobs) -> None:
        name = f"{prefix}-{index}"
        if fleet is None:
            serve(name, settings, cache, report_jobs, stop)
        else:
            serve_robots(name, fleet, cache, report_jobs, stop)

    fixed = invocation.arguments.count or settings.worker.count
    most = max(SPARE + 1, len(os.sched_getaffinity(0)))
    count = ChildCount(fixed, fixed) if fixed else ChildCount(SPARE + 1, most)
    run_forked(count, child, invocation.stop, name=prefix)


class Fleet:
    """The settings files of a fleet, ``NAME.toml``, one for each robot.

    An unusable file is logged, and is no other robot's problem. The overrides, as for ``--set``,
    hold for all robots. `problems` says why a file cannot be used; empty: it can.

    Raises:
        SettingsError: there is no settings file.
    """

    def __init__(self, folder: Path, overrides: Sequence[str]) -> None:
        self._overrides, self._files = overrides, dict[tuple[str, str], Path]()
        self.problems = dict.fromkeys(sorted(folder.glob("*.toml")), "")
        if not self.problems:
            raise SettingsError(f"--fleet {folder}: not a folder of settings files (*.toml)")
        for file in self.problems:
            try:
                self.settings(file)
            except ClusterMclError as error:
                self.problems[file] = str(error)
                _log.warning("%s is left out, and tried again: %s", file, error)

    def settings(self, file: Path) -> Settings:
        """Read and check a robot's file; refuse a second one of the same robot."""
        settings = load_settings(file, self._overrides)
        if settings.zenoh.router.startswith("tls/"):
            check_files(settings.zenoh)  # before the fork, so that one line tells of it
        robot = settings.robot.name
        first = self._files.setdefault((settings.zenoh.router, robot), file)
        if first != file:
            problem = f"--fleet: {first} and {file} are both of robot {robot!r}: remove one"
            raise SettingsError(key="--fleet", problem=problem)
        return settings


def serve(
    name: str, settings: Settings, cache: Path, report_jobs: ReportJobs, stop: StopFlag
) -> None:
    with closing(Node(name, "worker", settings, stop, peers=keys.COORDINATOR_ALIVE)) as node:
        node.open()
        work_without_preempting()
        WorkerLoop(node, cache, report_jobs).run()


def serve_robots(
    name: str, fleet: Fleet, cache: Path, report_jobs: ReportJobs, stop: StopFlag
) -> None:
    """Serve several robots, each in a thread that begins again after an error."""
    jobs = dict.fromkeys(fleet.problems, 0)

    def serve_robot(file: Path, stop: StopFlag) -> None:
        jobs[file] = 0
        serve(name, fleet.settings(file), cache, partial(jobs.__setitem__, file), stop)

    run_in_threads(
        [
            restarted(partial(serve_robot, file), str(file), logged=problem)
            for file, problem in fleet.problems.items()
        ],
        stop,
        on_turn=lambda: report_jobs(sum(jobs.values())),
    )


class WorkerLoop:
    """Passes messages to a `Worker` and carries out its instructions, without blocking."""

    def __init__(self, node: Node, cache_folder: Path, report_jobs: ReportJobs) -> None:
        self._node, self._cache_folder = node, cache_folder
        self._report_jobs = report_jobs
        self._worker, self._pause = Worker(node.name), SearchPause()
        self._adviser = Adviser(node)
        self._reports = node.publisher(keys.worker_report(node.name), may_wait=True)
        node.publish_health(keys.worker_health(node.name))
        self._scans = node.subscribe(
            keys.SCAN, Scan, self._on_scan, kind="scan", kept=KEPT_SCANS, paused=True
        )
        self._checkpoints = node.poll(keys.CHECKPOINT, Checkpoint, "checkpoint", KEPT_CHECKPOINTS)
        node.serve(keys.worker_order(node.name), self._on_order, WorkOrder.max_bytes)
        node.serve(keys.worker_state(node.name), self._on_state)
        node.serve(keys.worker_advice(node.name), self._on_advice)
        node.announce(keys.worker_alive(node.name))
        report_jobs(0)

    def run(self) -> None:
        unread_scans = 0
        while not self._node.stop.is_set():
            pause_s = min(self._pause.left_ns(time.monotonic_ns()) / 1e9, PAUSE_S)
            event = self._node.turn(pause_s if self._worker.searches else POLL_S)
            unread_scans = unread_scans + 1 if isinstance(event, Received) else SCANS_PER_POLL
            if unread_scans >= SCANS_PER_POLL:
                unread_scans = 0
                self._node.drain(self._checkpoints, self._on_checkpoint)
                if self._worker.searches and not self._pause.left_ns(time.monotonic_ns()):
                    self._carry_out(self._worker.search())

    # --- messages

    def _on_scan(self, scan: Scan, _received: Received) -> None:
        self._node.health.happened("scans")
        self._pause.on_scan(scan.step, time.monotonic_ns())
        self._carry_out(self._worker.on_scan(scan, self._node.inbox.dropped().get("scan", 0)))

    def _on_checkpoint(self, payload: bytes) -> None:
        checkpoint = _with_term(payload, Checkpoint)
        self._pause.on_checkpoint(checkpoint.step, founded=checkpoint.founded)
        self._carry_out(self._worker.on_checkpoint(checkpoint))

    def _on_order(self, asked: Asked) -> None:
        try:
            order = _with_term(asked.payload, WorkOrder)
        except MalformedMessageError as error:
            self._carry_out(self._worker.refuse(asked, error))
        else:
            self._carry_out(self._worker.on_order(asked, order))

    def _on_state(self, asked: Asked) -> None:
        self._carry_out(self._worker.on_take_over(asked, _with_term(asked.payload, TakeOver)))
        self._node.trim_heap_soon()

    def _on_advice(self, asked: Asked) -> None:
        self._carry_out(self._worker.on_advice_query(asked, decode(asked.payload, AdviceQuestion)))

    # --- instructions

    def _carry_out(self, instructions: Iterable[Instruction]) -> None:
        self._scans.pause(not self._worker.needs_scans)  # a scan would only wake this process
        reports = list[Report]()
        for instruction in instructions:
            match instruction:
                case do.Answer(asked, message):
                    asked.answer(message)
                    self._report_jobs(self._worker.jobs)
                case do.FetchMap():
                    self._fetch_map()
                case do.BuildModel():
                    self._build(instruction)
                case do.FetchScans():
                    self._fetch_scans(instruction)
                case do.Warn(cause, detail):
                    self._node.warn(_log, cause, detail)
                case do.Advise():
                    self._adviser.advise(instruction)
                case report:
                    reports.append(report)
                    self._node.health.happened("reports")
        for reported in in_few_messages(reports):
            self._reports.put(reported)

    def _fetch_map(self) -> None:
        def on_failure(refused: str) -> None:
            problem = f"no answer on {keys.MAP!r}: {refused or 'there is no bridge'}"
            error = UnreachableError(peer=keys.MAP, problem=problem, waited_s=MAP_TIMEOUT_S)
            self._carry_out(self._worker.on_map_failure(error))

        self._node.ask(
            keys.MAP,
            MapMessage,
            lambda message: self._carry_out(self._worker.on_map(message)),
            on_failure,
            timeout_s=MAP_TIMEOUT_S,
        )

    def _fetch_scans(self, fetch: do.FetchScans) -> None:
        missing, worker = fetch.missing, self._worker

        def on_failure(refused: str) -> None:
            self._carry_out(worker.on_no_history(missing, refused or "there is no bridge"))

        self._node.ask(
            keys.scan_history(missing.first, missing.last),
            ScanHistory,
            lambda history: self._carry_out(worker.on_history(missing, history.scans)),
            on_failure,
            timeout_s=fetch.timeout_s,
            repeat_for_s=REPEAT_FOR_S,
        )

    def _build(self, build: do.BuildModel) -> None:
        def built() -> SensorModel:
            model = sensor_model(from_message(build.map), build.settings, self._cache_folder)
            free_leaves(model.grid, model.pyramid.leaf_cells)  # slow; cached for searches
            return model

        def on_built(outcome: Future[SensorModel]) -> None:
            try:
                model = outcome.result()
            except (ClusterMclError, ValueError) as error:
                self._carry_out(self._worker.on_map_failure(error))
            else:
                self._carry_out(self._worker.on_model(build.map.digest, model))

        self._node.in_background(built, on_built)


def _with_term(payload: bytes, kind: type[T]) -> T:
    """Decode a coordinator's message and check its term."""
    message = decode(payload, kind)
    check_term(message, time.time_ns())
    return message
