"""What searches do to the latency of tracked clusters: `python -m benchmarks.search_latency`.

Runs a whole stack with a simulated robot whose every scan is a step (10 Hz) and that searches
everywhere again and again. Steps whose scan came while a search computed, and steps whose scan
came while none did, stand side by side: from the scan's encoding to the belief, all in one run.
"""

import argparse
import json
import os
import tempfile
from collections import defaultdict
from pathlib import Path

import numpy as np

from benchmarks.latency import run_stack


def latencies(folder: Path, skip: int) -> dict[str, list[float]]:
    """Milliseconds of each step from `skip` on, by whether a search computed when its scan came."""
    begun, believed = dict[int, int](), dict[int, int]()
    searched = defaultdict[int, list[int]](list)
    for file in folder.iterdir():
        for line in file.read_text().splitlines():
            step, event, _, stamp = line.split()
            at = int(stamp)
            match event:
                case "Scan.encode":
                    begun.setdefault(int(step), at)
                case "Belief.encode":
                    believed.setdefault(int(step), at)
                case "SearchReport.put":
                    searched[int(step)].append(at)
    spans = [(begun[step], max(puts)) for step, puts in searched.items() if step in begun]
    result: dict[str, list[float]] = {"without": [], "with": []}
    for step, at in begun.items():
        if step >= skip and step in believed:
            busy = any(first <= at <= last for first, last in spans)
            result["with" if busy else "without"].append((believed[step] - at) / 1e6)
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=180.0)
    parser.add_argument("--every", type=int, default=60, help="steps from one search to the next")
    parser.add_argument("--world", default="office")
    parser.add_argument("--skip", type=int, default=100, help="steps at the start left out")
    parser.add_argument("--set", action="append", default=[], metavar="SECTION.KEY=VALUE")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        settings = [
            f"bridge.source=sim:{options.world}",
            f"belief.search_every_steps={options.every}",
            *options.set,
        ]
        run_stack(Path(name), options.seconds, 0.0, settings, 0)
        found = latencies(Path(name), options.skip)
    told: dict[str, object] = {"load": round(os.getloadavg()[0], 1)}
    for which, values in found.items():
        if values:
            p50, p99 = np.percentile(values, (50, 99)).round(2).tolist()
            told[which] = {"steps": len(values), "p50_ms": p50, "p99_ms": p99}
    print(json.dumps(told))


if __name__ == "__main__":
    main()
