"""The definition of an experiment: robot, length, number of runs, algorithms."""

from typing import Literal

import msgspec

from benchmarks.people import CrowdSimulation
from benchmarks.worlds import world
from clustermcl.evaluation import run
from clustermcl.evaluation.run import RecordedRobot
from clustermcl.protocol.errors import SettingsError
from clustermcl.simulator.simulation import Simulation

Algorithm = Literal[
    "cluster-mcl",
    "paper-letter",
    "mcl",
    "amcl",
    "amcl-tuned",
    "amcl-kld",
]
NAMES: dict[Algorithm, str] = {
    "cluster-mcl": "Cluster-MCL",
    "paper-letter": "the paper's letter",
    "mcl": "ordinary MCL",
    "amcl": "augmented MCL",
    "amcl-tuned": "augmented MCL, own gains",
    "amcl-kld": "augmented MCL, KLD-sampling",
}

BASELINES: tuple[Algorithm, ...] = ("paper-letter", "mcl", "amcl")
"""Baselines: the paper's version, the textbook filter, and one that recovers."""
Role = Literal["training", "validation", "test"]
"""Training: constants were fitted on it. Validation: it was observed meanwhile. Test: it never
influenced a choice."""


class AfterStep(msgspec.Struct, frozen=True):
    """The robot is kidnapped after this step; the first step is 0."""

    step: int


class OnceRight(msgspec.Struct, frozen=True):
    """The robot is kidnapped once the estimate was right 40 times in a row."""

    at_latest: int
    """At the latest it is kidnapped after this many updates."""


class SimulatedRobot(run.SimulatedRobot, frozen=True, kw_only=True):
    """A simulated robot that may be kidnapped, or among people."""

    people: int = 0
    """Number of people who walk near the robot."""
    kidnapping: AfterStep | OnceRight | None = None

    def simulation(self, seed: int) -> Simulation:
        return CrowdSimulation(world(self.world), seed, self.people)


class Case(run.Case, frozen=True, kw_only=True):
    """One experiment."""

    name: str
    """Name on the command line."""
    title: str
    robot: SimulatedRobot | RecordedRobot
    updates_after_event: int | None = None
    """A run ends this number of updates after the feature was seen or the robot was kidnapped."""
    role: Role = "validation"
    """The building's role in the choice of the defaults."""
    seeds: int
    """Default number of runs of each algorithm; all use the same seeds."""
    baselines: tuple[Algorithm, ...] = BASELINES
    symmetry: int = 1
    """The map is k-fold symmetric, or nearly so."""
    has_feature: bool = False
    """Whether a feature of the map distinguishes the symmetric poses."""

    @property
    def algorithms(self) -> tuple[Algorithm, ...]:
        """All algorithms, Cluster-MCL first."""
        return ("cluster-mcl", *self.baselines)


def algorithm_named(name: str) -> Algorithm:
    """Return an algorithm by its name.

    Raises:
        SettingsError: there is no algorithm of this name.
    """
    for algorithm in NAMES:
        if algorithm == name:
            return algorithm
    problem = f"--algorithm {name}: there is {' or '.join(NAMES)}"
    raise SettingsError(key="--algorithm", problem=problem)
