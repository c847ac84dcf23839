"""What a stack takes of memory: `python -m benchmarks.memory [--workers N ...] [--map FILE]`.

Proportional set size from /proc/PID/smaps_rollup: a page that n processes share counts as a
n-th in each, so the sum is what the stack really takes. Measured once all clusters are tracked.
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
from pathlib import Path

import msgspec
import numpy as np
import psutil

from clustermcl.client import Client
from clustermcl.protocol.errors import ClusterMclError
from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.recordings.maps.ros_map import save_ros_map
from clustermcl.runtime.settings import Settings
from clustermcl.simulator.worlds.catalogue import world

COMMAND = (sys.executable, "-I", "-m", "clustermcl")


def offices(side: int) -> GridMap:
    """A square map with cells of 5 cm: copies of the simulator's office."""
    whole = world("office").map
    rows, cols = whole.cells.shape
    cells = np.tile(whole.cells, (side // rows + 1, side // cols + 1))[:side, :side]
    return GridMap(np.ascontiguousarray(cells), whole.cell_m, (0.0, 0.0, 0.0))


def proportional_mb(process: psutil.Process) -> float:
    """PSS of one process."""
    for line in Path(f"/proc/{process.pid}/smaps_rollup").read_text().splitlines():
        if line.startswith("Pss:"):
            return int(line.split()[1]) / 1024
    raise ValueError(f"no Pss of process {process.pid}")


def by_part(up: psutil.Process) -> dict[str, list[float]]:
    """PSS of every process of a stack, by what it is."""
    sizes: dict[str, list[float]] = defaultdict(list)
    for process in [up, *up.children(recursive=True)]:
        words = process.cmdline()
        names = (
            "simulator",
            "sensor_bridge",
            "coordinator",
            "worker",
            "clustermcl.link.router",
        )
        part = next((name for name in names if name in words), "clustermcl up")
        sizes[part].append(proportional_mb(process))
    return dict(sizes)


def measured(settings: list[str], seconds: float, timeout_s: float) -> dict[str, list[float]]:
    """Start a stack, wait until it tracks, and then for this time; prints the peak of the sum."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        router = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    zenoh = msgspec.structs.replace(Settings().zenoh, router=router)
    client_settings = msgspec.structs.replace(Settings(), zenoh=zenoh)
    words = [word for one in (f"zenoh.router={router}", *settings) for word in ("--set", one)]
    popen = subprocess.Popen([*COMMAND, "up", *words], stdin=subprocess.DEVNULL)
    up = psutil.Process(popen.pid)
    peak_mb, tracked_since = 0.0, None
    start_s = time.monotonic()
    try:
        while time.monotonic() - start_s < timeout_s:
            time.sleep(0.5)
            sizes = by_part(up)
            peak_mb = max(peak_mb, sum(sum(part) for part in sizes.values()))
            try:
                with Client(client_settings) as client:
                    status = client.status()
            except ClusterMclError:
                continue
            if status.clusters and tracked_since is None:
                tracked_since = time.monotonic()
                taken_s = tracked_since - start_s
                print(f"{status.clusters} clusters after {taken_s:.1f} s, step {status.step}")
            if tracked_since is not None and time.monotonic() > tracked_since + seconds:
                print(f"{status.state}, step {status.step}; peak of the sum {peak_mb:.0f} MB")
                return sizes
        raise SystemExit(f"nothing tracked in {timeout_s:g} s; peak of the sum {peak_mb:.0f} MB")
    finally:
        popen.send_signal(signal.SIGINT)
        popen.wait(30)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--workers", type=int, nargs="+", default=[12, 16])
    parser.add_argument("--side", type=int, default=800, help="cells of the map's side")
    parser.add_argument("--map", help="a map file in place of a tiled office")
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--timeout", type=float, default=240.0)
    parser.add_argument("--set", action="append", default=[], metavar="SECTION.KEY=VALUE")
    options = parser.parse_args()
    sums = []
    with tempfile.TemporaryDirectory() as folder:
        map_file = options.map or Path(folder, "map.yaml")
        if not options.map:
            save_ros_map(offices(options.side), map_file)
        for workers in options.workers:
            settings = [f"bridge.source=sim:{map_file}", f"worker.count={workers}", *options.set]
            settings.append(f"worker.cache_folder={folder}/cache")
            sizes = measured(settings, options.seconds, options.timeout)
            for part, each in sorted(sizes.items()):
                print(f"  {part}: {len(each)} x {np.mean(each):.1f} MB")
            sums.append(sum(sum(each) for each in sizes.values()))
            print(f"{workers} workers: {sums[-1]:.0f} MB in all", flush=True)
    if len(sums) > 1:
        more = (sums[-1] - sums[0]) / (options.workers[-1] - options.workers[0])
        print(f"each further worker: {more:.1f} MB")
    print(f"load average {os.getloadavg()[0]:.1f}")


if __name__ == "__main__":
    main()
