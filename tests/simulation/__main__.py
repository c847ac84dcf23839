"""Run many schedules: ``python -m tests.simulation --schedules 100000``."""

import argparse
import os
import sys
import time
from multiprocessing import Pool

from tests.simulation.simulation import Simulation
from tests.unit.coordinator.living import symmetric_room

_MODEL = []


def _broken(seed: int) -> str:
    if not _MODEL:
        _MODEL.append(symmetric_room())
    try:
        Simulation(seed, _MODEL[0]).run()
    except Exception as error:  # noqa: BLE001 - whatever it is, the seed is told
        return " ".join([f"{type(error).__name__}:", str(error), *getattr(error, "__notes__", ())])
    return ""


def main() -> int:
    """Run, tell what was broken, and how long it took."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--schedules", type=int, default=2000)
    parser.add_argument("--first", type=int, default=0, help="seed of the first schedule")
    parser.add_argument("--processes", type=int, default=os.cpu_count())
    arguments = parser.parse_args()
    seeds = range(arguments.first, arguments.first + arguments.schedules)
    began_s, broken = time.perf_counter(), 0
    with Pool(arguments.processes) as pool:
        for problem in pool.imap_unordered(_broken, seeds, chunksize=16):
            if problem:
                broken += 1
                print(problem, flush=True)  # noqa: T201 - a command
    took_s = time.perf_counter() - began_s
    print(f"{len(seeds)} schedules, {broken} broken a law, {took_s:.0f} s")  # noqa: T201
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
