"""Write a dated report of ratios: `python -m benchmarks.report [--rounds N] [--only TEXT] FILE`.

Times depend on the machine and its other guests; ratios less. So all ways of a piece of work run
in turn, a few milliseconds each, and each round gives one ratio; CPU time, not wall time.
"""

import argparse
import platform
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.cases import Case, all_cases
from benchmarks.floor import COMMAND

_ROUND_S = 0.01


@dataclass(frozen=True)
class Measured:
    """Times of one case by way, a round each [ns per unit]."""

    case: Case
    times: dict[str, np.ndarray]

    def ratio(self, way: str) -> str:
        """Our time over that of another way: minimum, median, maximum over the rounds."""
        if way not in self.times:
            return "|  | "
        ratios = self.times["ours"] / self.times[way]
        return f"| {np.median(ratios):.2f} | {ratios.min():.2f} to {ratios.max():.2f} "


def measured(case: Case, rounds: int) -> Measured:
    """Run all ways of a case in turn."""
    case.check()
    ways = {
        name: run
        for name, run in (("ours", case.ours), ("plain", case.plain), ("floor", case.floor))
        if run is not None
    }
    repeats = {name: max(1, round(_ROUND_S / _seconds(run, 1))) for name, run in ways.items()}
    times: dict[str, list[float]] = {name: [] for name in ways}
    for _ in range(rounds):
        for name, run in ways.items():
            times[name].append(_seconds(run, repeats[name]) / case.units * 1e9)
    return Measured(case, {name: np.array(values) for name, values in times.items()})


def _seconds(run: Callable[[], object], repeats: int) -> float:
    start_s = time.thread_time()
    for _ in range(repeats):
        run()
    return max(time.thread_time() - start_s, 1e-7) / repeats


def table(results: Sequence[Measured]) -> str:
    lines = [
        "| work | unit | ns, least | ours / C: median | range | ours / numpy: median | range |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for result in results:
        least = result.times["ours"].min()
        row = f"| {result.case.name} | {result.case.unit} | {least:.3g} "
        lines.append(row + result.ratio("floor") + result.ratio("plain") + "|")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--only", default="", help="cases whose name holds this")
    options = parser.parse_args()
    chosen = [case for case in all_cases() if options.only in case.name]
    results = []
    for case in chosen:
        results.append(measured(case, options.rounds))
        print(table(results[-1:]).splitlines()[-1], flush=True)
    options.file.write_text(
        f"# Kernels compared with C and numpy, {options.file.stem}\n\n"
        f"{platform.machine()}, Python {platform.python_version()}, numpy {np.__version__}; "
        f"one thread, CPU time, {options.rounds} rounds in which all ways ran in turn. "
        f"C: `{' '.join(COMMAND)} floor.c`, the same work on the same numbers. A ratio under 1 "
        "means that ours is faster.\n\nWritten by `python -m benchmarks.report`; times are this "
        "machine's, ratios carry over.\n\n" + table(results) + "\n",
        encoding="utf-8",
    )


if __name__ == "__main__":
    main()
