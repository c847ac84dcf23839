"""What searches do to the latency of tracked clusters: `python -m benchmarks.search_latency`.

Runs a whole stack with a simulated robot whose every scan is a step (10 Hz) and that searches
everywhere again and again. It prints the milliseconds from scan to belief, as another client sees
them, of steps whose scan came while a search computed, and of the others.
"""

import argparse
import json
import os
from collections import defaultdict

import numpy as np

from benchmarks.latency import Seen, run_stack
from clustermcl.protocol.answers import Belief
from clustermcl.protocol.steps import Scan
from clustermcl.protocol.work import SearchReport


def latencies(seen: Seen, skip: int) -> dict[str, list[float]]:
    """Milliseconds of each step from `skip` on, by whether a search computed when its scan came."""
    begun, believed = dict[int, int](), dict[int, int]()
    searched = defaultdict[int, list[int]](list)
    for at_ns, message in seen:
        match message:
            case Scan(step=step):
                begun.setdefault(step, at_ns)
            case Belief(step=step):
                believed.setdefault(step, at_ns)
            case SearchReport(step=step):
                searched[step].append(at_ns)
    spans = [(begun[step], max(reports)) for step, reports in searched.items() if step in begun]
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
    settings = [
        f"bridge.source=sim:{options.world}",
        f"belief.search_every_steps={options.every}",
        *options.set,
    ]
    _, _, seen = run_stack(options.seconds, 0.0, settings, 0)
    found = latencies(seen, options.skip)
    result: dict[str, object] = {"load": round(os.getloadavg()[0], 1)}
    for which, values in found.items():
        if values:
            p50, p99 = np.percentile(values, (50, 99)).round(2).tolist()
            result[which] = {"steps": len(values), "p50_ms": p50, "p99_ms": p99}
    print(json.dumps(result))


if __name__ == "__main__":
    main()
