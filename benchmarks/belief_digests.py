"""Digests of beliefs, to show that a change of the code changed no belief, bit for bit.

    python -m benchmarks.belief_digests DATA [--seeds N] > before.txt

DATA is a folder with the recordings `wean` and `intel`. A digest covers, step for step, what the
in-process run believes: state, hypotheses, jobs that begin and end. The same machine, kernels and
libraries give the same digests; another machine's need not agree in the last digit.
"""

import argparse
import hashlib
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from benchmarks.experiments.case import AfterStep, Case, RecordedRobot, SimulatedRobot
from benchmarks.experiments.task import Run, Task
from benchmarks.wean import WeanRobot
from clustermcl.belief.outcome import Outcome
from clustermcl.runtime.folders import kept_folder
from clustermcl.runtime.settings import Settings


def cases(data: Path) -> list[Case]:
    """Two simulated and two recorded ones."""
    wean, intel = data / "wean", data / "intel"
    kidnapped = SimulatedRobot(world="office", kidnapping=AfterStep(100))
    return [
        _case("cross", SimulatedRobot(world="cross"), updates=300),
        _case("office, kidnapped", kidnapped, updates=300),
        _case("Wean 1", WeanRobot(recording=wean / "robotdata1.log.xz", map=wean / "map.yaml")),
        _case("Intel", _recorded(intel / "log.clf.gz", intel / "map.yaml")),
    ]


def _case(name: str, robot: SimulatedRobot | RecordedRobot, updates: int | None = None) -> Case:
    return Case(name=name, title=name, robot=robot, updates=updates, seeds=1, baselines=())


def _recorded(recording: Path, grid_map: Path) -> RecordedRobot:
    return RecordedRobot(recording=recording, map=grid_map, reference=None)


def digest(work: tuple[Case, int]) -> str:
    """A line that names a case and a seed, and the digest of all its beliefs."""
    case, seed = work
    task = Task(
        case=case,
        algorithm="cluster-mcl",
        seed=seed,
        settings=Settings(),
        cache_folder=kept_folder("maps"),
    )
    whole, count = hashlib.sha256(), 0
    for outcome in Run(task).outcomes():
        for fact in _facts(outcome):
            whole.update(repr(fact).encode())
        count += 1
    return f"{case.name}, seed {seed}, {count} steps: {whole.hexdigest()}"


def _facts(outcome: Outcome) -> Iterator[object]:
    yield outcome.step, outcome.state, outcome.searching, outcome.missing
    yield sorted(outcome.begin), sorted(outcome.end)
    for place in outcome.hypotheses:
        yield place.cluster, place.probability, place.log_probability, place.age_steps
        yield place.pose, place.covariance, place.effective_sample_size


def main() -> None:
    """Print a line for every course and seed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path, help="folder with the recordings")
    parser.add_argument("--seeds", type=int, default=3, metavar="N")
    asked = parser.parse_args()
    work = [(one, seed) for one in cases(asked.data) for seed in range(asked.seeds)]
    with ProcessPoolExecutor(2) as pool:
        for line in pool.map(digest, work):
            print(line, flush=True)


if __name__ == "__main__":
    main()
