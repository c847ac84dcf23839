"""Where the time from scan to belief goes: `python -m benchmarks.latency [--particles N] ...`.

Runs a whole stack on this machine with a simulated robot whose every scan is a step (10 Hz). One
more client of the router notes when scans, reports and beliefs arrive.
"""

import argparse
import os
import signal
import socket
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
import zenoh

from benchmarks.processor_time import ByThread, in_between, processes_table, spent_by_thread
from clustermcl.link.session import open_session
from clustermcl.link.wire import ask
from clustermcl.protocol import keys
from clustermcl.protocol.advice import Advice
from clustermcl.protocol.answers import Belief
from clustermcl.protocol.codec import decode
from clustermcl.protocol.errors import ClusterMclError
from clustermcl.protocol.message import Message
from clustermcl.protocol.steps import Scan
from clustermcl.protocol.work import Reported, reports_in
from clustermcl.runtime.settings_file import load_settings
from clustermcl.runtime.stop import StopFlag

Seen = list[tuple[int, Message]]
"""Arrival [ns] and content of each scan, report and belief, in order."""
_KEYS: dict[str, type[Message]] = {
    keys.SCAN: Scan,
    keys.ALL_REPORTS: Reported,  # type: ignore[dict-item] # a union
    keys.BELIEF: Belief,
}


def stages_of(seen: Seen) -> tuple[dict[str, np.ndarray], int]:
    """Return the milliseconds of each stage of each step, and the usual number of reports."""
    scans, beliefs = dict[int, int](), dict[int, int]()
    reports = defaultdict[int, list[int]](list)
    for at_ns, message in seen:
        match message:
            case Scan(step=step):
                scans.setdefault(step, at_ns)
            case Belief(step=step):
                beliefs.setdefault(step, at_ns)
            case _:
                for report in reports_in(message):  # type: ignore[arg-type] # the third key's
                    reports[report.step].append(at_ns)
    times = []
    for step in sorted(scans.keys() & beliefs.keys() & reports.keys()):
        in_time = [at_ns for at_ns in reports[step] if at_ns <= beliefs[step]]
        if in_time:
            times.append((scans[step], in_time[0], in_time[-1], beliefs[step]))
    ms = np.diff(np.array(times).reshape(-1, 4)) / 1e6
    stages = {
        "scan to the first report": ms[:, 0],
        "first to last report": ms[:, 1],
        "last report to belief": ms[:, 2],
        "**scan to belief**": ms.sum(axis=1),
    }
    return stages, int(np.median([len(each) for each in reports.values()] or [0]))


def table(stages: dict[str, np.ndarray]) -> str:
    lines = ["| stage, as another client sees it | p50 ms | p99 ms |", "| --- | --- | --- |"]
    for name, values in stages.items():
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


@contextmanager
def limited(cores: float) -> Iterator[tuple[str, ...]]:
    """Yield the first words of a command that gets this share of the cores; 0: no limit.

    They start it in a control group of its own (version 1 or 2), which needs root.
    """
    if not cores:
        yield ()
        return
    root = Path("/sys/fs/cgroup")
    is_second = (root / "cgroup.controllers").exists()
    group = (root if is_second else root / "cpu") / f"mclbench{os.getpid()}"
    group.mkdir()
    period_us = 100_000
    if is_second:
        (group / "cpu.max").write_text(f"{int(cores * period_us)} {period_us}")
    else:
        (group / "cpu.cfs_quota_us").write_text(str(int(cores * period_us)))
    try:
        yield ("sh", "-c", f'echo $$ > {group}/cgroup.procs; exec "$@"', "sh")
    finally:
        group.rmdir()


def _run(*command: str) -> None:
    subprocess.run(command, check=True, stdin=subprocess.DEVNULL)


def run_stack(
    seconds: float,
    watched_s: float,
    settings: Sequence[str],
    far_workers: int,
    options: Sequence[str] = (),
    cores: float = 0.0,
    *,
    advice: bool = False,
) -> tuple[ByThread, int, Seen]:
    """Run a stack for this time; `settings` as for `--set`; some workers on the far machine.

    With `advice`, a client asks for advice all the time while the stack is watched.

    Returns:
        What each thread of it took over the last `watched_s`, when they began [ns], and what
        another client saw.
    """
    with (
        network(far_workers > 0) as (address, over_there),
        limited(cores) as limit,
        ExitStack() as started,
    ):
        with socket.socket() as probe:
            probe.bind((address, 0))
            port = probe.getsockname()[1]
        assignments = [
            f"zenoh.router=tcp/{address}:{port}",
            "bridge.gate_distance_m=0",
            "bridge.gate_turn_rad=0",
            *settings,
        ]
        words = [word for setting in assignments for word in ("--set", setting)]
        near = [*limit, sys.executable, "-I", "-m", "clustermcl", "up", *options, *words]
        far = [*over_there, sys.executable, "-I", "-m", "clustermcl.worker", *words]
        far += ["--name", "far", "--count", str(far_workers)]
        for command in (near, far) if far_workers else (near,):
            started.enter_context(_ended(subprocess.Popen(command, stdin=subprocess.DEVNULL)))
        payloads = started.enter_context(_observed(assignments))
        time.sleep(seconds - watched_s)
        before, begun_ns = spent_by_thread(), time.monotonic_ns()
        if advice:
            _ask_for_advice(assignments, watched_s)
        else:
            time.sleep(watched_s)
        spent = in_between(before, spent_by_thread())
    return spent, begun_ns, [(at_ns, decode(data, _KEYS[key])) for at_ns, key, data in payloads]


@contextmanager
def _observed(assignments: Sequence[str]) -> Iterator[list[tuple[int, str, bytes]]]:
    """Yield a growing list of arrival [ns], key and payload of all messages of `_KEYS`."""
    settings, payloads = load_settings(None, assignments), list[tuple[int, str, bytes]]()
    with open_session(settings.zenoh, settings.robot, StopFlag(), wait_s=30.0) as session:
        for key in _KEYS:

            def note(sample: zenoh.Sample, key: str = key) -> None:
                payloads.append((time.monotonic_ns(), key, sample.payload.to_bytes()))

            session.declare_subscriber(key, note)
        yield payloads


def _ask_for_advice(assignments: Sequence[str], seconds: float) -> None:
    """Ask again as soon as there is an answer."""
    settings, answers, until_s = load_settings(None, assignments), 0, time.monotonic() + seconds
    with open_session(settings.zenoh, settings.robot, StopFlag(), wait_s=30.0) as session:
        while time.monotonic() < until_s:
            try:
                ask(session, keys.ADVICE, Advice, timeout_s=20.0)
                answers += 1
            except ClusterMclError as error:
                print(error)
                time.sleep(0.1)
    print(f"{answers} answers to questions for advice in {seconds:g} s")


def steps_sent(seen: Seen, begun_ns: int, watched_s: float) -> int:
    """How many steps the robot has made in that time: fewer than it would, where all are slow."""
    end_ns = begun_ns + watched_s * 1e9
    return sum(isinstance(each, Scan) and begun_ns <= at_ns < end_ns for at_ns, each in seen)


@contextmanager
def _ended(process: subprocess.Popen[bytes]) -> Iterator[None]:
    """End it as Ctrl-C does."""
    try:
        yield
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(20)


def as_many_all_the_time(clusters: int) -> list[str]:
    """Settings with which no cluster ends and no later search begins."""
    return [
        f"belief.max_clusters={clusters}",
        "belief.search_every_steps=1000000",
        "belief.least_probability=1e-12",
        "search.source_radius_m=0.1",
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--particles", type=int, default=1_000)
    parser.add_argument("--clusters", type=int, default=10)
    parser.add_argument("--workers", type=int, default=0, help="0: by need")
    parser.add_argument("--far", type=int, default=0, help="more workers, in a network namespace")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--watched", type=float, default=20.0, help="CPU time of the last seconds")
    parser.add_argument("--world", default="office")
    parser.add_argument("--skip", type=int, default=50, help="steps at the start left out")
    parser.add_argument("--set", action="append", default=[], metavar="SECTION.KEY=VALUE")
    parser.add_argument("--one-process", action="store_true")
    parser.add_argument(
        "--own-clusters",
        action="store_true",
        help="as many clusters as the belief has by default, over the watched seconds only",
    )
    parser.add_argument("--cores", type=float, default=0.0, help="limit, such as 0.5; needs root")
    parser.add_argument(
        "--advice",
        action="store_true",
        help="ask for advice all the time while watched; latencies before it and with it",
    )
    options = parser.parse_args()
    spent, begun_ns, seen = run_stack(
        options.seconds,
        options.watched,
        [
            f"bridge.source=sim:{options.world}",
            f"cluster.particles={options.particles}",
            f"worker.count={options.workers}",
            *([] if options.own_clusters else as_many_all_the_time(options.clusters)),
            *options.set,
        ],
        options.far,
        ("--one-process",) if options.one_process else (),
        options.cores,
        advice=options.advice,
    )
    if options.advice:
        before, _ = stages_of([each for each in seen if each[0] < begun_ns])
        print(table({f"{name}, no advice": ms[options.skip :] for name, ms in before.items()}))
    if options.own_clusters or options.advice:
        options.skip, seen = 0, [each for each in seen if each[0] >= begun_ns]
    stages, reports = stages_of(seen)
    steps = steps_sent(seen, begun_ns, options.watched)
    print(processes_table(spent, max(steps, 1)))
    cpu_ms = sum(each.cpu_ns for each in spent.values()) / 1e6
    print(f"CPU of a step, all processes: {cpu_ms / max(steps, 1):.1f} ms; ", end="")
    share, rate = cpu_ms / 1e3 / options.watched / (os.cpu_count() or 1), steps / options.watched
    print(f"{100 * share:.0f} % of this machine at {rate:.1f} steps a second")
    print(f"load average {os.getloadavg()[0]:.1f}, {time.strftime('%Y-%m-%d %H:%M')}")
    traced = len(next(iter(stages.values()))) - options.skip
    if traced <= 0:
        raise SystemExit("too few steps were seen from scan to belief; run it for longer")
    decided = {message.step for _, message in seen if isinstance(message, Belief)}
    sent = {message.step for _, message in seen if isinstance(message, Scan)}
    print(f"{len(sent - decided)} of {len(sent)} steps without a belief")
    print(f"{traced} steps, {reports} clusters of {options.particles} particles")
    print(table({name: values[options.skip :] for name, values in stages.items()}))


if __name__ == "__main__":
    main()
