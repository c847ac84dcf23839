"""Measures how well searches find a robot: `python -m benchmarks.searches KIND WORLD [--seeds 20]`.

A robot starts at a random pose in a generated office, or in a symmetric world. Each run is one line
of JSON in `--out`; runs that the file already has are skipped, so a study can be interrupted and
continued. `python -m benchmarks.searches` summarises the file.

Kinds:
    search: a first search until it ends; measures whether the truth is among its places.
    localize: 200 updates of the whole filter in one process; measures when its estimate is right.
    kidnap: the same, with a kidnapping after 60 updates; measures when it is right again.
    cbgl: the first scan by CBGL's cumulative absolute error per ray (`benchmarks.cbgl`).
"""

import argparse
import json
import os
import statistics
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

from benchmarks import cbgl
from benchmarks.experiments.observability import middle_of, turned_copies
from benchmarks.worlds import world as named_world
from clustermcl.belief.search_pool import SearchPool
from clustermcl.evaluation.measures import CONFIDENT_PROBABILITY, pose_error
from clustermcl.filter.laser.sensor_model import SensorModel
from clustermcl.jobs.in_process import InProcess
from clustermcl.jobs.jobs import running
from clustermcl.jobs.map_model import sensor_model
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.pose_arrays import pose_tuple
from clustermcl.protocol.steps import Scan
from clustermcl.protocol.work import Assignment, SearchJob, SearchReport
from clustermcl.runtime.folders import kept_folder
from clustermcl.runtime.settings import Settings
from clustermcl.runtime.settings_file import load_settings
from clustermcl.simulator.simulation import Simulation, simulated_steps
from clustermcl.simulator.worlds.office import office
from clustermcl.simulator.worlds.world import World

OFFICES = {"5,900": (5, 18), "13,000": (7, 28), "50,000": (14, 54)}
"""Area in square metres: number of wings, and rooms on a side of a wing."""
SYMMETRIES = {"cross": 4, "rectangle": 2, "hall_symmetric": 2}
"""Symmetric worlds and their order of symmetry."""
UPDATES, KIDNAPPED_AT, IN_A_ROW = 200, 60, 5

Result = dict[str, Any]
_OUT = Path(__file__).parent / "reports" / "2026-11-23-searches.jsonl"


class Place:
    """A world, ready to be searched."""

    def __init__(self, name: str, settings: Settings) -> None:
        self.settings = settings
        self.world: World = office(*OFFICES[name]) if name in OFFICES else named_world(name)
        self.model: SensorModel = sensor_model(self.world.map, settings.sensor, kept_folder("maps"))
        self._turns, self._middle = SYMMETRIES.get(name, 1), middle_of(self.world.map)

    def steps(
        self, seed: int, steps: int | None = None, kidnap_at: int | None = None
    ) -> Iterator[tuple[Scan, PoseTuple]]:
        """What a robot that starts anywhere sees, and where it is."""
        simulation = Simulation(self.world, seed)
        for scan, truth in simulated_steps(simulation, self.settings.bridge, steps=steps):
            if scan.step == kidnap_at:
                simulation.kidnap()
            yield scan, truth

    def ranks(self, places: list[PoseTuple], truth: PoseTuple) -> list[int | None]:
        """Of the truth and each of its copies: its place in a list; None: it is not there."""
        found = []
        for copy in turned_copies(truth, self._turns, self._middle):
            right = [pose_error(place, copy).right for place in places]
            found.append(right.index(True) if any(right) else None)
        return found


def search(place: Place, seed: int) -> Result:
    """Run a first search to its end, its shards one after the other."""
    settings, took_s = place.settings, list[float]()
    rules, most = settings.search, settings.belief.max_clusters
    for scan, truth in place.steps(seed):
        if not took_s:
            pool = SearchPool(tuple(f"s0.{n}" for n in range(rules.shards)), scan.step)
            jobs = [
                running(
                    Assignment(job_id=job_id, epoch=0, job=SearchJob(search=0, shard=shard,
                               first_step=scan.step)),
                    place.model, settings, sender="benchmark",
                )
                for shard, job_id in enumerate(pool.job_ids)
            ]  # fmt: skip
        start_s = time.process_time()
        for job in jobs:
            report = job.advance(scan)
            assert isinstance(report, SearchReport)
            pool.add(report)
        pooled = pool.pooled(rules)
        took_s.append(time.process_time() - start_s)
        if pooled is None:
            continue
        ranks = place.ranks([pose_tuple(mean) for mean in pooled.mean], truth)
        if len(took_s) == 1:
            first_ranks = ranks
        if pool.finished(pooled, settings, patient=True):
            return {
                "held": all(rank is not None and rank < most for rank in ranks),
                "first_ranks": first_ranks,
                "ranks": ranks,
                "scans": len(took_s),
                "first_s": took_s[0],
                "later_s": sum(took_s[1:]),
            }
    raise AssertionError("a simulated robot drives for ever")


def localize(place: Place, seed: int) -> Result:
    """From which of 200 updates on the estimate is right, and what an update costs."""
    return _scored(place, place.steps(seed, steps=UPDATES), 0)


def kidnap(place: Place, seed: int) -> Result:
    """As `localize`, from being lifted elsewhere on; 60 updates."""
    steps = place.steps(seed, steps=2 * KIDNAPPED_AT, kidnap_at=KIDNAPPED_AT)
    return _scored(place, steps, KIDNAPPED_AT)


def _scored(place: Place, steps: Iterator[tuple[Scan, PoseTuple]], after: int) -> Result:
    process, took_s = InProcess(place.model, place.settings), 0.0
    right, sure = list[bool](), list[bool]()
    for scan, truth in steps:
        start_s = time.process_time()
        outcome = process.advance(scan)
        took_s += time.process_time() - start_s
        best = outcome.hypotheses[0] if outcome.hypotheses else None
        answered = best is not None and outcome.state not in ("searching", "lost")
        right.append(answered and pose_error(best.pose, truth).right)
        sure.append(answered and best.probability >= CONFIDENT_PROBABILITY)
    return {
        "right_before": right[after - 1] if after else None,
        "right_after": _first_of_some(right[after:]),
        "right_at_end": right[-1],
        "sure_and_wrong": sum(s and not r for r, s in zip(right, sure, strict=True)),
        "update_ms": 1e3 * took_s / len(right),
    }


def _first_of_some(right: list[bool]) -> int | None:
    """The first of five updates in a row that are right, counted from 1."""
    for first in range(len(right) - IN_A_ROW + 1):
        if all(right[first : first + IN_A_ROW]):
            return first + 1
    return None


def by_cbgl(place: Place, seed: int) -> Result:
    """The first scan by the sum of absolute errors of its rays."""
    scan, truth = next(place.steps(seed))
    start_s = time.process_time()
    poses = cbgl.places(scan, place.world.map, place.settings.belief.max_clusters, seed)
    took_s = time.process_time() - start_s
    ranks = place.ranks(poses, truth)
    return {"held": None not in ranks, "ranks": ranks, "first_s": took_s}


KINDS: dict[str, Callable[[Place, int], Result]] = {
    "search": search,
    "localize": localize,
    "kidnap": kidnap,
    "cbgl": by_cbgl,
}


def summed_up(file: Path) -> None:
    """One line of a table for each kind and world."""
    runs = defaultdict[tuple[str, str], list[Result]](list)
    for run in _read(file):
        runs[run["kind"], run["world"]].append(run)
    for (kind, world), some in sorted(runs.items()):
        words = [f"{kind} {world}: {len(some)} runs"]
        if "held" in some[0]:
            words.append(
                f"truth and all its copies among the places {sum(r['held'] for r in some)}"
            )
        if "right_after" in some[0]:
            found = sorted(r["right_after"] for r in some if r["right_after"])
            words.append(f"right {len(found)}, at the end {sum(r['right_at_end'] for r in some)}")
            words.append(f"after {found}, sure and wrong {[r['sure_and_wrong'] for r in some]}")
        for name in ("scans", "first_s", "later_s", "update_ms"):
            if name in some[0]:
                values = [r[name] for r in some]
                words.append(f"{name} {statistics.median(values):.3g} (most {max(values):.3g})")
        print("; ".join(words))


def _read(file: Path) -> list[Result]:
    return [json.loads(line) for line in file.read_text().splitlines()] if file.exists() else []


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("kind", nargs="?", choices=KINDS)
    arguments.add_argument("worlds", nargs="*", metavar="WORLD")
    arguments.add_argument("--seeds", type=int, default=20)
    arguments.add_argument("--out", type=Path, default=_OUT)
    arguments.add_argument("--set", action="append", default=[], metavar="SECTION.KEY=VALUE")
    given = arguments.parse_args()
    if given.kind is None:
        summed_up(given.out)
        return
    done = {(run["kind"], run["world"], run["seed"]) for run in _read(given.out)}
    settings, ready = load_settings(None, given.set), cache(Place)
    for world in given.worlds:
        for seed in range(given.seeds):
            if (given.kind, world, seed) not in done:
                result = KINDS[given.kind](ready(world, settings), seed)
                result = {"kind": given.kind, "world": world, "seed": seed, **result}
                result["load"] = round(os.getloadavg()[0], 1)
                with given.out.open("a") as out:
                    out.write(json.dumps(result) + "\n")
                print(result, flush=True)


if __name__ == "__main__":
    main()
