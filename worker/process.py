"""The worker process: one parent that compiles the kernels, and children that do the jobs."""

import argparse
import time
from functools import partial
from pathlib import Path

import numpy as np

from particle_filter.settings import FilterSettings
from process_runtime.latency_trace import start_trace
from process_runtime.main import Invocation, process_main
from process_runtime.prefork import run_forked
from process_runtime.scheduling import work_without_preempting
from process_runtime.stop import StopFlag
from protocol import keys
from worker.loop import WorkerLoop
from worker.map_model import default_cache_folder
from worker.warm_up import compile_kernels
from zenoh_link.session import open_session
from zenoh_link.stale_session import is_there


def main() -> None:
    """Run the worker processes."""
    process_main(
        "worker",
        run_workers,
        describe="Workers of Cluster-MCL: each tracks a cluster of particles or searches.",
        add_arguments=_add_arguments,
    )


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--count", type=int, metavar="N", help="worker processes (default: worker.count)"
    )


def run_workers(invocation: Invocation) -> None:
    """Compile once, fork the workers, keep them alive until told to stop."""
    settings, prefix = invocation.settings, invocation.process
    folder = settings.worker.cache_folder
    cache = Path(folder).expanduser() if folder else default_cache_folder()
    compile_kernels(FilterSettings(), np.random.default_rng(0))

    def child(index: int, stop: StopFlag) -> None:
        name = f"{prefix}-{index}"
        start_trace(settings.log.trace_folder, name)
        is_coordinator_there = partial(
            is_there, settings.zenoh, settings.robot, stop, keys.COORDINATOR_ALIVE
        )
        while not stop.is_set():
            with open_session(settings.zenoh, settings.robot, stop, wait_s=None) as session:
                work_without_preempting()
                WorkerLoop(name, session, cache, time.time_ns(), is_coordinator_there).run(stop)

    run_forked(
        invocation.arguments.count or settings.worker.count, child, invocation.stop, name=prefix
    )
