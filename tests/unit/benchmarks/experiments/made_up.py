"""Made-up steps, runs and experiments, small enough to check by hand."""

from typing import Any

import msgspec

from benchmarks.experiments.case import Case, SimulatedRobot
from benchmarks.experiments.measures import RunMeasures, Update, measures_of, update_of
from benchmarks.experiments.observability import turned_copies
from clustermcl.protocol.answers import Hypothesis, State
from clustermcl.protocol.message import PoseTuple
from tests.unit.evaluation.places import outcome, place

NOWHERE: PoseTuple = (50.0, 50.0, 0.0)
TRUTH: PoseTuple = (5.0, 0.0, 0.0)
OPPOSITE: PoseTuple = (-5.0, 0.0, 3.14)
"""Its copy in a world that is symmetric about the origin."""
COPIES = turned_copies(TRUTH, 2, (0.0, 0.0))


def at(probability: float, mean_pose: PoseTuple = TRUTH) -> Hypothesis:
    return place(probability, mean_pose)


def facts(update: int, *places: Hypothesis, state: State = "localized") -> Update:
    return update_of(update, update * 10**9, outcome(state, *places), COPIES)


def right_or_wrong(pattern: str) -> list[Update]:
    """A run: `r` right, `w` wrong, `W` wrong and sure, `a` right but ambiguous, `s` searching."""
    made = {
        "r": lambda n: facts(n, at(1.0)),
        "w": lambda n: facts(n, at(0.5, NOWHERE)),
        "W": lambda n: facts(n, at(0.95, NOWHERE)),
        "a": lambda n: facts(n, at(0.6), at(0.4, OPPOSITE), state="ambiguous"),
        "s": lambda n: facts(n, at(1.0), state="searching"),
    }
    return [made[letter](n) for n, letter in enumerate(pattern, start=1)]


def measures(**changed: Any) -> RunMeasures:
    """Of a run of no step, but for what is given."""
    return msgspec.structs.replace(measures_of([]), **changed)


def case(**changed: Any) -> Case:
    made = Case(
        name="made-up",
        title="Made up",
        robot=SimulatedRobot(world="rectangle"),
        updates=12,
        seeds=2,
        baselines=("mcl",),
    )
    return msgspec.structs.replace(made, **changed)
