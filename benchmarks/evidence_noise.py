"""How noisy the evidence of a cluster is: a study of particles, exponents and resampling.

    python -m benchmarks.evidence_noise [--steps N]

Places that look exactly alike are tracked side by side from the truth and its mirror images.
Their evidences should be equal; the log of their ratio is Monte Carlo error, and its sum over
steps is a random walk. Its long-run standard deviation per root step comes from batch means.
"""

import argparse
import math
from concurrent.futures import ProcessPoolExecutor
from itertools import combinations
from multiprocessing import get_context

import msgspec
import numpy as np

from benchmarks.experiments.observability import middle_of, turned_copies
from benchmarks.worlds import world
from clustermcl.filter.cluster import cluster_filter
from clustermcl.filter.cluster.cluster_filter import ParticleSet
from clustermcl.filter.poses import between
from clustermcl.filter.settings import FilterSettings
from clustermcl.jobs.map_model import sensor_model
from clustermcl.jobs.scan_arrays import scan_beams
from clustermcl.runtime.settings import BridgeSettings
from clustermcl.simulator.simulation import Simulation, simulated_steps

ALIKE = {"cross": 4, "rectangle": 2}
SETTLE_STEPS, BATCH_STEPS = 20, 50
VARIATIONS: tuple[dict[str, dict[str, object]], ...] = (
    {},
    *({"cluster": {"particles": count}} for count in (500, 4000, 8000)),
    *({"sensor": {"scan_likelihood_exponent": power}} for power in (0.03, 0.05, 0.2, 0.4, 1.0)),
    *({"cluster": {"resample_below_ess": share}} for share in (0.1, 0.5, 1.0)),
    *({"sensor": {"max_beams": beams}} for beams in (30, 120)),
)


def noise(name: str, changes: dict[str, dict[str, object]], steps: int) -> tuple[float, float]:
    """Standard deviation of the log-ratio of two evidences: of one step, and long-run."""
    settings = msgspec.convert(changes, FilterSettings)
    place, count = world(name), ALIKE[name]
    model = sensor_model(place.map, settings.sensor, cache_folder=None)
    rngs = [np.random.default_rng([1, index]) for index in range(count)]
    clouds: list[ParticleSet] = []
    before = np.zeros(3)
    evidence = []
    for scan, truth in simulated_steps(Simulation(place, seed=1), BridgeSettings()):
        after = np.array(scan.odom_from_robot)
        if not clouds:
            alike = turned_copies(truth, count, middle_of(place.map))
            clouds = [
                ParticleSet.even(
                    np.array(pose)
                    + rng.standard_normal((settings.cluster.particles, 3)) * [0.1, 0.1, 0.05]
                )
                for pose, rng in zip(alike, rngs, strict=True)
            ]
        else:
            beams, motion = scan_beams(scan, model), between(before, after)
            weighed = [
                cluster_filter.mcl_step(
                    cloud, motion, beams, model, settings.motion, settings.cluster, rng
                )
                for cloud, rng in zip(clouds, rngs, strict=True)
            ]
            clouds = [result.particles for result in weighed]
            evidence.append([result.log_weight_sum for result in weighed])
        before = after
        if len(evidence) == steps:
            break
    log_evidence = np.array(evidence)[SETTLE_STEPS:]
    ratios = [log_evidence[:, i] - log_evidence[:, j] for i, j in combinations(range(count), 2)]
    batches = [
        ratio[: len(ratio) // BATCH_STEPS * BATCH_STEPS].reshape(-1, BATCH_STEPS).sum(axis=1)
        for ratio in ratios
    ]
    return float(np.std(ratios)), float(np.std(batches) / math.sqrt(BATCH_STEPS))


def main() -> None:
    """Print a Markdown table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=1500)
    steps = parser.parse_args().steps
    cases = [(name, changes, steps) for changes in VARIATIONS for name in ALIKE]
    print("| settings that differ | world | one step [nat] | long run [nat per root step] |")
    print("| --- | --- | --- | --- |")
    with ProcessPoolExecutor(mp_context=get_context("spawn")) as pool:
        results = pool.map(noise, *zip(*cases, strict=True))
        for (name, changes, _), (one, long_run) in zip(cases, results, strict=True):
            words = ", ".join(f"{k} = {v}" for part in changes.values() for k, v in part.items())
            print(f"| {words or 'none'} | {name} | {one:.3f} | {long_run:.3f} |", flush=True)


if __name__ == "__main__":
    main()
