"""Run many schedules: ``python -m tests.simulation --schedules 100000``."""

import argparse
import sys
import time

from tests.simulation.many import broken, processes


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--schedules", type=int, default=2000)
    parser.add_argument("--first", type=int, default=0, help="seed of the first schedule")
    parser.add_argument("--processes", type=int, default=None, help="usual: one a core")
    arguments = parser.parse_args()
    seeds = range(arguments.first, arguments.first + arguments.schedules)
    began_s, count = time.perf_counter(), 0
    with processes(arguments.processes) as pool:
        for problem in broken(pool, seeds):
            count += 1
            print(problem, flush=True)  # noqa: T201 - a command
    took_s = time.perf_counter() - began_s
    print(f"{len(seeds)} schedules, {count} broken a law, {took_s:.0f} s")  # noqa: T201
    return 1 if count else 0


if __name__ == "__main__":
    sys.exit(main())
