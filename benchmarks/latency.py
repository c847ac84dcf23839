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
from collections.abc import Sequence
from pathlib import Path

import numpy as np

Stamps = dict[tuple[int, str, str], int]
"""(step, event, sender): when [ns]."""
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


def run_stack(folder: Path, seconds: float, settings: Sequence[str]) -> None:
    """A stack for so long; `settings` as for `--set`."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    assignments = [
        f"zenoh.router=tcp/127.0.0.1:{port}",
        f"log.trace_folder={folder}",
        "bridge.gate_distance_m=0",
        "bridge.gate_turn_rad=0",
        *settings,
    ]
    command = [sys.executable, "-c", "from clustermcl.command import main; main()", "up"]
    command += [part for setting in assignments for part in ("--set", setting)]
    environment = os.environ | {"PYTHONUNBUFFERED": "1"}
    process = subprocess.Popen(command, stdin=subprocess.DEVNULL, env=environment)
    try:
        process.wait(seconds)
    except subprocess.TimeoutExpired:
        process.send_signal(signal.SIGTERM)
        process.wait(20)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--particles", type=int, default=1_000)
    parser.add_argument("--clusters", type=int, default=10)
    parser.add_argument("--workers", type=int, default=12)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--world", default="office")
    parser.add_argument("--skip", type=int, default=50, help="steps at the start left out")
    parser.add_argument("--set", action="append", default=[], metavar="SECTION.KEY=VALUE")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        run_stack(
            Path(name),
            options.seconds,
            [
                f"bridge.source=sim:{options.world}",
                f"cluster.particles={options.particles}",
                f"belief.clusters={options.clusters}",
                f"worker.count={options.workers}",
                "belief.search_every_steps=1000000",
                *options.set,
            ],
        )
        stages, whole, reports = stages_of(Path(name))
    if not len(whole):
        raise SystemExit("no step was traced from scan to belief; run it for longer")
    stages = {name: values[options.skip :] for name, values in stages.items()}
    print(f"{len(whole) - options.skip} steps, {reports} clusters of {options.particles} particles")
    print(table(stages, whole[options.skip :]))
    print(f"load average {os.getloadavg()[0]:.1f}, {time.strftime('%Y-%m-%d %H:%M')}")


if __name__ == "__main__":
    main()
