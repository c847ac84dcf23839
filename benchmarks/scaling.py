"""Cost of a step against the size of everything: `python -m benchmarks.scaling`.

CPU time of one thread, the least of some rounds: what other processes do counts little. These
are the numbers of docs/results.md.
"""

import time
from itertools import islice

from benchmarks.in_process import steps

VARIED: dict[str, list[dict[str, int]]] = {
    "clusters": [{"clusters": count} for count in (1, 2, 5, 10, 20, 40, 64)],
    "particles": [
        {"particles": count} for count in (250, 500, 1_000, 2_000, 5_000, 10_000, 50_000)
    ],
    "beams scored": [{"beams": count} for count in (15, 30, 60, 120, 181, 360, 720)],
    "side of the map [800 cells]": [{"tiles": count} for count in (1, 2, 5)],
}
DEFAULTS = {"clusters": 10, "particles": 1_000, "beams": 60, "tiles": 1}


def step_ms(size: dict[str, int], seconds: float = 2.0) -> float:
    """CPU time of a step: the median of blocks of steps, least of the blocks."""
    going = steps(**(DEFAULTS | size))
    list(islice(going, 3))
    blocks: list[float] = []
    end_s = time.thread_time() + seconds
    while time.thread_time() < end_s:
        start_s = time.thread_time()
        next(going)
        blocks.append(time.thread_time() - start_s)
    return 1e3 * sorted(blocks)[len(blocks) // 4]


def main() -> None:
    for what, sizes in VARIED.items():
        print(f"| {what} | ms a step | us a cluster |\n| --- | --- | --- |")
        for size in sizes:
            taken_ms = step_ms(size)
            each_us = 1e3 * taken_ms / (DEFAULTS | size)["clusters"]
            print(f"| {next(iter(size.values())):,} | {taken_ms:.2f} | {each_us:.0f} |", flush=True)
        print()


if __name__ == "__main__":
    main()
