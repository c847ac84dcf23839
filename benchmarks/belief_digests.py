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
from dataclasses import dataclass
from pathlib import Path

import msgspec

from coordinator.belief.outcome import Outcome
from evaluation import in_process
from evaluation.evaluation import EvaluateOptions, Run, course, model_of
from process_runtime.settings import Settings


@dataclass(frozen=True)
class Course:
    """What a robot drives, by name."""

    name: str
    options: EvaluateOptions


def courses(data: Path) -> list[Course]:
    """Two simulated and two recorded ones."""
    wean, intel = data / "wean", data / "intel"
    return [
        Course("cross", EvaluateOptions(recording="sim:cross")),
        Course("office, kidnapped", EvaluateOptions(recording="sim:office", kidnap_at=100)),
        Course(
            "Wean 1",
            EvaluateOptions(
                recording=str(wean / "robotdata1.log.xz"), map_file=str(wean / "map.yaml")
            ),
        ),
        Course(
            "Intel",
            EvaluateOptions(recording=str(intel / "log.clf.gz"), map_file=str(intel / "map.yaml")),
        ),
    ]


def digest(work: tuple[Course, int]) -> str:
    """A line that names a course and a seed, and the digest of all its beliefs."""
    course_of, seed = work
    run = Run(course_of.options, msgspec.structs.replace(Settings(), seed=seed))
    grid_map, steps = course(run)
    whole, count = hashlib.sha256(), 0
    scans = (scan for scan, _ in steps)
    for _, outcome in in_process.outcomes(scans, model_of(run, grid_map), run.settings):
        for fact in _facts(outcome):
            whole.update(repr(fact).encode())
        count += 1
    return f"{course_of.name}, seed {seed}, {count} steps: {whole.hexdigest()}"


def _facts(outcome: Outcome) -> Iterator[object]:
    yield outcome.step, outcome.state, outcome.searching, outcome.missing
    yield sorted(outcome.begin), sorted(outcome.end)
    for place in outcome.hypotheses:
        yield place.cluster, place.probability, place.log_probability, place.age_steps
        yield place.mean, place.covariance, place.effective_sample_size


def main() -> None:
    """Print a line for every course and seed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path, help="folder with the recordings")
    parser.add_argument("--seeds", type=int, default=3, metavar="N")
    asked = parser.parse_args()
    work = [(one, seed) for one in courses(asked.data) for seed in range(asked.seeds)]
    with ProcessPoolExecutor(2) as pool:
        for line in pool.map(digest, work):
            print(line, flush=True)


if __name__ == "__main__":
    main()
