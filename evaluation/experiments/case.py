"""The definition of an experiment: robot, length, number of runs, algorithms."""

from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Literal

import msgspec

from coordinator.belief.outcome import Outcome
from evaluation import in_process, ordinary_mcl, paper_letter
from evaluation.ordinary_mcl import Variant
from evaluation.recovery import RecoveryGains
from particle_filter.sensor_model import SensorModel
from particle_filter.settings import FilterSettings
from protocol.errors import SettingsError
from protocol.steps import Scan

Algorithm = Literal[
    "cluster-mcl",
    "paper-letter",
    "mcl",
    "mcl-visibility",
    "amcl",
    "amcl-visibility",
    "amcl-tuned",
    "amcl-kld",
]
AMCL_GAINS = RecoveryGains(slow=0.001, fast=0.1)
"""The values that Beluga and nav2 recommend."""
TUNED_GAINS = RecoveryGains(slow=0.01, fast=0.3)
"""Tuned by us, on seeds that no experiment uses; docs/decisions/fair-baselines.md."""
Outcomes = Callable[[Iterable[Scan], SensorModel, FilterSettings], Iterator[tuple[Scan, Outcome]]]
ALGORITHMS: dict[Algorithm, Outcomes] = {
    "cluster-mcl": in_process.outcomes,
    "paper-letter": paper_letter.outcomes,
    "mcl": ordinary_mcl.outcomes,
    "mcl-visibility": partial(ordinary_mcl.outcomes, variant=Variant(visibility=True)),
    "amcl": partial(ordinary_mcl.outcomes, variant=Variant(recovery=AMCL_GAINS)),
    "amcl-visibility": partial(
        ordinary_mcl.outcomes, variant=Variant(visibility=True, recovery=AMCL_GAINS)
    ),
    "amcl-tuned": partial(
        ordinary_mcl.outcomes, variant=Variant(visibility=True, recovery=TUNED_GAINS)
    ),
    "amcl-kld": partial(
        ordinary_mcl.outcomes, variant=Variant(visibility=True, recovery=AMCL_GAINS, kld=True)
    ),
}
"""Cluster-MCL; the same exactly as in the paper; ordinary MCL, plain and with visibility; both
with augmented recovery; with our recovery gains and visibility; with KLD-sampling and
visibility."""

BASELINES: tuple[Algorithm, ...] = ("paper-letter", "mcl", "amcl-visibility")
"""Baselines: the paper's version, the textbook filter, and one with all our components."""
ALIKE_BASELINES: tuple[Algorithm, ...] = ("paper-letter", "mcl", "amcl")
"""Baselines in exactly symmetric worlds, where visibility adds no information."""
NAMES: dict[Algorithm, str] = {
    "cluster-mcl": "Cluster-MCL",
    "paper-letter": "the paper's letter",
    "mcl": "ordinary MCL",
    "mcl-visibility": "MCL with visibility",
    "amcl": "augmented MCL",
    "amcl-visibility": "augmented MCL with visibility",
    "amcl-tuned": "augmented MCL with visibility, own gains",
    "amcl-kld": "augmented MCL with visibility, KLD-sampling",
}

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


class SimulatedRobot(msgspec.Struct, frozen=True, kw_only=True):
    """A simulated robot."""

    world: str
    """Name of a world, or a map file."""
    map: Path | None = None
    """Map for the localizer; None: the world's own map."""
    people: int = 0
    """Number of people who walk near the robot."""
    kidnapping: AfterStep | OnceRight | None = None


class RecordedRobot(msgspec.Struct, frozen=True, kw_only=True):
    """A recorded robot."""

    recording: Path
    map: Path
    reference: Path | None
    """Ground truth; None: unknown, and no update is judged."""


class Case(msgspec.Struct, frozen=True, kw_only=True):
    """One experiment."""

    name: str
    """Name on the command line."""
    title: str
    robot: SimulatedRobot | RecordedRobot
    updates: int | None = None
    """Most steps of a run; None: to the recording's end."""
    updates_after_event: int | None = None
    """A run ends this number of updates after the feature was seen or the robot was kidnapped."""
    role: Role = "validation"
    """The building's role in the choice of the defaults."""
    seeds: int
    """Default number of runs of each algorithm; all use the same seeds."""
    baselines: tuple[Algorithm, ...] = BASELINES
    """Baselines."""
    symmetry: int = 1
    """The map is k-fold symmetric, or nearly so."""
    has_feature: bool = False
    """Whether a feature of the map distinguishes the symmetric poses."""
    mirrored: bool = False
    """Whether the robot is in the mirror image of the building, so nowhere on the map; no update
    is judged then."""
    settings: tuple[str, ...] = ()
    """Settings of the experiment, `section.key=value`."""

    @property
    def algorithms(self) -> tuple[Algorithm, ...]:
        """All algorithms, Cluster-MCL first."""
        return ("cluster-mcl", *self.baselines)


def algorithm_named(name: str) -> Algorithm:
    """Return an algorithm by its name.

    Raises:
        SettingsError: there is no algorithm of this name.
    """
    for algorithm in ALGORITHMS:
        if algorithm == name:
            return algorithm
    problem = f"--algorithm {name}: there is {' or '.join(ALGORITHMS)}"
    raise SettingsError(key="--algorithm", problem=problem)
