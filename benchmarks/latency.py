"""Where the time from scan to belief goes: `python -m benchmarks.latency [--particles N] ...`.

Runs a whole stack on this machine with a simulated robot whose every scan is a step (10 Hz), lets
all processes write their trace, and puts the traces together.
"""

import argparse
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np

from benchmarks.processor_time import ByThread, in_between, processes_table, spent_by_thread

Stamps = dict[tuple[int, str, str], int]
"""(step, event, sender): when [ns]."""
_UNTIL_WRITTEN_S = 3.0
"""Stamps are written some at a time."""
STAGES = (
    ("bridge: encode the scan", "Scan.encode", "Scan.put"),
    ("bridge: hand it to Zenoh", "Scan.put", "Scan.gone"),
    ("on the way to the worker", "Scan.gone", "Scan.arrived"),
    ("worker: wake up, take it from the inbox", "Scan.arrived", "Scan.taken"),
    ("worker: decode", "Scan.taken", "Scan.decoded"),
    ("worker: move, weigh, fit (kernels)", "Scan.decoded", "Scan.computed"),
    ("worker: encode the report", "Scan.computed", "TrackReport.put"),
    ("on the way to the coordinator", "TrackReport.put", "TrackReport.arrived"),
    ("coordinator: take it from the inbox", "TrackReport.arrived", "TrackReport.taken"),
    ("coordinator: decode", "TrackReport.taken", "TrackReport.decoded"),
    ("coordinator: apply the step", "TrackReport.decoded", "Belief.encode"),
    ("coordinator: encode and put the belief", "Belief.encode", "Belief.gone"),
)


def stages_of(folder: Path) -> tuple[dict[str, np.ndarray], np.ndarray, int]:
    """Milliseconds of each stage on the way of each step's last report; of the whole; workers."""
    per_step: dict[int, dict[str, dict[str, int]]] = defaultdict(lambda: defaultdict(dict))
    for file in folder.iterdir():
        process = file.name.rpartition("-")[0]
        for line in file.read_text().splitlines():
            step, event, sender, stamp = line.split()
            # Who did it: a worker for scans; whose report it was for the coordinator.
            who = sender if process == "coordinator" else process
            per_step[int(step)][event].setdefault(who, int(stamp))
    stages: dict[str, list[float]] = {name: [] for name, _, _ in STAGES}
    whole, workers = [], []
    for _, events in sorted(per_step.items()):
        if not {"Scan.encode", "Belief.gone", "TrackReport.decoded"} <= events.keys():
            continue
        last = max(events["TrackReport.decoded"], key=events["TrackReport.decoded"].__getitem__)
        times = [
            (_at(events, start, last), _at(events, end, last)) for _, start, end in STAGES
        ]  # fmt: skip
        if any(start is None or end is None for start, end in times):
            continue
        if times[-1][0] < times[-2][0]:
            continue  # the belief did not wait for this report
        for (name, _, _), (start, end) in zip(STAGES, times, strict=True):
            stages[name].append((end - start) / 1e6)
        whole.append((times[-1][1] - times[0][0]) / 1e6)
        workers.append(len(events["TrackReport.decoded"]))
    return (
        {name: np.array(values) for name, values in stages.items()},
        np.array(whole),
        int(np.median(workers)) if workers else 0,
    )


def _at(events: dict[str, dict[str, int]], event: str, worker: str) -> int | None:
    times = events.get(event, {})
    return times.get(worker, next(iter(times.values()), None) if len(times) == 1 else None)


def table(stages: dict[str, np.ndarray], whole: np.ndarray) -> str:
    lines = ["| stage, on the way of the last report | p50 ms | p99 ms |", "| --- | --- | --- |"]
    for name, values in [*stages.items(), ("**scan to belief**", whole)]:
        lines.append(
            f"| {name} | {np.percentile(values, 50):.2f} | {np.percentile(values, 99):.2f} |"
        )
    return "\n".join(lines)


@contextmanager
def network(far: bool) -> Iterator[tuple[str, tuple[str, ...]]]:
    """The address where processes meet, and what a command of the far machine begins with.

    The far machine is a network namespace at the other end of a cable (veth); it needs root.
    """
    if not far:
        yield "127.0.0.1", ()
        return
    name = f"mclbench{os.getpid()}"[:13]
    here, there, subnet = f"{name}a", f"{name}b", f"10.214.{os.getpid() % 250}"
    over_there = ("ip", "netns", "exec", name)
    _run("ip", "netns", "add", name)
    try:
        _run("ip", "link", "add", here, "type", "veth", "peer", "name", there, "netns", name)
        _run("ip", "addr", "add", f"{subnet}.1/30", "dev", here)
        _run("ip", "link", "set", here, "up")
        _run(*over_there, "ip", "addr", "add", f"{subnet}.2/30", "dev", there)
        _run(*over_there, "ip", "link", "set", there, "up")
        yield f"{subnet}.1", over_there
    finally:
        _run("ip", "netns", "del", name)


def _run(*command: str) -> None:
    subprocess.run(command, check=True, stdin=subprocess.DEVNULL)


def run_stack(
    folder: Path, seconds: float, watched_s: float, settings: Sequence[str], far_workers: int
) -> tuple[ByThread, int]:
    """Run a stack for this time; `settings` as for `--set`; some workers on the far machine.

    Returns:
        What each thread of it took over the last `watched_s`, and when they began [ns].
    """
    with network(far_workers > 0) as (address, over_there), ExitStack() as started:
        with socket.socket() as probe:
            probe.bind((address, 0))
            port = probe.getsockname()[1]
        assignments = [
            f"zenoh.router=tcp/{address}:{port}",
            f"log.trace_folder={folder}",
            "bridge.gate_distance_m=0",
            "bridge.gate_turn_rad=0",
            *settings,
        ]
        words = [word for setting in assignments for word in ("--set", setting)]
        near = [sys.executable, "-I", "-m", "clustermcl", "up", *words]
        far = [*over_there, sys.executable, "-I", "-m", "worker", *words]
        far += ["--name", "far", "--count", str(far_workers)]
        for command in (near, far) if far_workers else (near,):
            started.enter_context(_ended(subprocess.Popen(command, stdin=subprocess.DEVNULL)))
        time.sleep(seconds - watched_s)
        before, begun_ns = spent_by_thread(), time.monotonic_ns()
        time.sleep(watched_s)
        spent = in_between(before, spent_by_thread())
        time.sleep(_UNTIL_WRITTEN_S)
    return spent, begun_ns


def steps_sent(folder: Path, begun_ns: int, watched_s: float) -> int:
    """How many steps the robot has made in that time: fewer than it would, where all are slow."""
    lines = (line.split() for file in folder.iterdir() for line in file.read_text().splitlines())
    gone_ns = [int(stamp) for _, event, _, stamp in lines if event == "Scan.gone"]
    return sum(begun_ns <= at_ns < begun_ns + watched_s * 1e9 for at_ns in gone_ns)


@contextmanager
def _ended(process: subprocess.Popen[bytes]) -> Iterator[None]:
    """End it as Ctrl-C does."""
    try:
        yield
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(20)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--particles", type=int, default=1_000)
    parser.add_argument("--clusters", type=int, default=10)
    parser.add_argument("--workers", type=int, default=12)
    parser.add_argument("--far", type=int, default=0, help="more workers, in a network namespace")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--watched", type=float, default=20.0, help="CPU time of the last seconds")
    parser.add_argument("--world", default="office")
    parser.add_argument("--skip", type=int, default=50, help="steps at the start left out")
    parser.add_argument("--set", action="append", default=[], metavar="SECTION.KEY=VALUE")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        spent, begun_ns = run_stack(
            Path(name),
            options.seconds,
            options.watched,
            [
                f"bridge.source=sim:{options.world}",
                f"cluster.particles={options.particles}",
                f"belief.max_clusters={options.clusters}",
                f"worker.count={options.workers}",
                "belief.search_every_steps=1000000",
                # As many clusters all the time:
                "belief.least_probability=1e-12",
                "belief.merge_every_steps=1000000",
                "cluster.split_every_steps=0",
                *options.set,
            ],
            options.far,
        )
        stages, whole, reports = stages_of(Path(name))
        steps = steps_sent(Path(name), begun_ns, options.watched)
    print(processes_table(spent, max(steps, 1)))
    cpu_ms = sum(each.cpu_ns for each in spent.values()) / 1e6
    print(f"CPU of a step, all processes: {cpu_ms / max(steps, 1):.1f} ms; ", end="")
    share, rate = cpu_ms / 1e3 / options.watched / (os.cpu_count() or 1), steps / options.watched
    print(f"{100 * share:.0f} % of this machine at {rate:.1f} steps a second")
    print(f"load average {os.getloadavg()[0]:.1f}, {time.strftime('%Y-%m-%d %H:%M')}")
    if len(whole) <= options.skip:
        raise SystemExit("too few steps were traced from scan to belief; run it for longer")
    stages = {name: values[options.skip :] for name, values in stages.items()}
    print(f"{len(whole) - options.skip} steps, {reports} clusters of {options.particles} particles")
    print(table(stages, whole[options.skip :]))


if __name__ == "__main__":
    main()
