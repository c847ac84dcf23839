"""Made-up steps, runs and experiments, small enough to check by hand."""

from collections.abc import Sequence
from typing import Any

import msgspec

from evaluation.experiments.case import Case, SimulatedRobot
from evaluation.experiments.figures import Figure, mean, rate
from evaluation.experiments.measures import RunMeasures, measures_of
from evaluation.experiments.provenance import Provenance
from evaluation.experiments.reliability import Reliability
from evaluation.experiments.results import ExperimentResult, RunRecord
from evaluation.experiments.step_facts import StepFacts, facts_of
from evaluation.experiments.symmetry import turned_copies
from protocol.answers import Hypothesis, State
from protocol.message import PoseTuple

NOWHERE: PoseTuple = (50.0, 50.0, 0.0)
TRUTH: PoseTuple = (5.0, 0.0, 0.0)
OPPOSITE: PoseTuple = (-5.0, 0.0, 3.14)
"""Its copy in a world that is symmetric about the origin."""
COPIES = turned_copies(TRUTH, 2, (0.0, 0.0))


def place(probability: float, mean_pose: PoseTuple = TRUTH, cluster: int = 0) -> Hypothesis:
    return Hypothesis(
        cluster=cluster,
        probability=probability,
        log_probability=0.0,
        mean=mean_pose,
        covariance=(0.01, 0, 0, 0, 0.01, 0, 0, 0, 0.01),
        effective_sample_size=1.0,
        age_steps=0,
    )


def facts(update: int, *places: Hypothesis, state: State = "localized") -> StepFacts:
    return facts_of(update, update * 10**9, state, places, COPIES)


def right_or_wrong(pattern: str) -> list[StepFacts]:
    """A run: `r` right, `w` wrong, `W` wrong and sure, `a` right but ambiguous, `s` searching."""
    made = {
        "r": lambda n: facts(n, place(1.0)),
        "w": lambda n: facts(n, place(0.5, NOWHERE)),
        "W": lambda n: facts(n, place(0.95, NOWHERE)),
        "a": lambda n: facts(n, place(0.6), place(0.4, OPPOSITE), state="ambiguous"),
        "s": lambda n: facts(n, place(1.0), state="searching"),
    }
    return [made[letter](n) for n, letter in enumerate(pattern, start=1)]


def measures(**changed: Any) -> RunMeasures:
    """Of a run of no step, but for what is given."""
    return msgspec.structs.replace(measures_of([]), **changed)


FIGURES: tuple[Figure, ...] = (
    rate("right at the end", "localized", at_least=1),
    mean("error once right", "rmse_m", at_most=0.15, unit="m"),
)


def case(name: str = "made-up", **changed: Any) -> Case:
    made = Case(
        name=name,
        title="Made up",
        robot=SimulatedRobot(world="rectangle"),
        updates=12,
        typical_updates=12,
        seeds=2,
        baselines=("mcl",),
        figures=FIGURES,
        update_ms=1.0,
        ordinary_update_ms=2.0,
    )
    return msgspec.structs.replace(made, **changed)


ORIGIN = Provenance(
    command="clustermcl experiments made-up",
    version="1.2.3",
    commit="abc",
    started="2001-02-03 04:05 UTC",
    machine="a machine",
    python="3",
    numpy="2",
    numba="0",
    jobs=2,
    settings={"belief.max_clusters": 3},
)


def claims(*pairs: tuple[float, bool]) -> Reliability:
    made = Reliability()
    for probability, right in pairs:
        made.add(probability, right)
    return made


def result(runs: Sequence[RunRecord], **changed: Any) -> ExperimentResult:
    return ExperimentResult(case=case(**changed), provenance=ORIGIN, runs=list(runs))


def a_run(algorithm: Any = "cluster-mcl", seed: int = 0, **measured: Any) -> RunRecord:
    return RunRecord(algorithm=algorithm, seed=seed, measures=measures(**measured))
