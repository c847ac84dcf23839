"""How well and how fast the first search finds a robot: `python -m benchmarks.searches`.

Offices of several sizes, drawn by the simulator's generator; a robot starts anywhere. For each:
whether the truth is among the places from which tracking begins when the search says that it is
done, after how many scans that is, and the CPU time of its shards one after the other.
"""

import argparse
import resource
import statistics
import time
from dataclasses import dataclass

from coordinator.belief.search_pool import SearchPool
from evaluation.judge import pose_error
from particle_filter.sensor_model import SensorModel
from process_runtime.settings import Settings
from process_runtime.settings_file import load_settings
from protocol.work import Assignment, SearchJob, SearchReport
from robot_simulator.simulation import Simulation
from robot_simulator.source import SimulatedSource, simulated_steps
from robot_simulator.worlds.office import office
from robot_simulator.worlds.world import World
from worker.jobs import running
from worker.map_model import default_cache_folder, sensor_model

SIZES = {"5,900": (5, 18), "13,000": (7, 28), "50,000": (14, 54)}
"""About so many square metres: wings, and rooms on a side of one."""


@dataclass(frozen=True)
class Found:
    """One search."""

    rank: int | None
    """Of the truth among its places; None: it is none of them."""
    steps: int
    first_s: float
    later_s: float


def searched(world: World, model: SensorModel, settings: Settings, seed: int) -> Found:
    """Search for a robot that starts anywhere until the search says that it is done."""
    rules, took_s = settings.search, list[float]()
    source = SimulatedSource(Simulation(world, seed))
    for scan, truth in simulated_steps(source, settings.bridge, world.map.digest):
        if not took_s:
            pool = SearchPool(0, scan.step, rules)
            jobs = [
                running(
                    Assignment(job_id=job_id, epoch=0, job=SearchJob(search=0, shard=shard,
                               first_step=scan.step)),
                    model, settings, sender="benchmark",
                )
                for shard, job_id in enumerate(pool.job_ids)
            ]  # fmt: skip
        start_s = time.process_time()
        for job in jobs:
            report = job.advance(scan)
            assert isinstance(report, SearchReport)
            pool.add(report)
        pooled = pool.pooled()
        took_s.append(time.process_time() - start_s)
        if pooled is not None and pool.finished(pooled, rules.places_with_particles):
            right = [pose_error(place.mean, truth).right for place in pooled.places]
            rank = right.index(True) if any(right) else None
            return Found(rank, len(took_s), took_s[0], sum(took_s[1:]))
    raise AssertionError("a simulated robot drives for ever")


def main() -> None:
    arguments = argparse.ArgumentParser()
    arguments.add_argument("sizes", nargs="*", default=list(SIZES))
    arguments.add_argument("--starts", type=int, default=20)
    arguments.add_argument("--set", action="append", default=[])
    given = arguments.parse_args()
    settings = load_settings(None, given.set)
    for size in given.sizes:
        world = office(*SIZES[size])
        start_s = time.process_time()
        model = sensor_model(world.map, settings.sensor, default_cache_folder())
        print(f"## {world.summary}; its model took {time.process_time() - start_s:.1f} s")
        found = []
        for seed in range(given.starts):
            found.append(searched(world, model, settings, seed))
            print(seed, found[-1], flush=True)
        most = settings.search.places_with_particles
        held = sum(run.rank is not None and run.rank < most for run in found)
        print(
            f"the truth is among the places in {held} of {len(found)}; "
            f"median {statistics.median(run.steps for run in found)} scans; "
            f"the first {statistics.median(run.first_s for run in found):.2f} s, "
            f"all others {statistics.median(run.later_s for run in found):.2f} s; "
            f"{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6:.2f} GB",
            flush=True,
        )


if __name__ == "__main__":
    main()
