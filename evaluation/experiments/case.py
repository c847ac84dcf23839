"""One experiment: a robot somewhere, how long, how often, and what is asked of it."""

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
"""What Beluga and nav2 recommend."""
TUNED_GAINS = RecoveryGains(slow=0.01, fast=0.3)
"""Our own choice, on seeds that no experiment uses; docs/decisions/fair-baselines.md."""
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
"""Cluster-MCL; the same by the paper's letter; ordinary MCL, plain and with visibility; the same
two with augmented recovery; that with gains of our own, and with KLD-sampling, both with
visibility."""

BASELINES: tuple[Algorithm, ...] = ("paper-letter", "mcl", "amcl-visibility")
"""What runs beside Cluster-MCL: the paper's own, the filter of the textbooks, and one with all the
same pieces."""
ALIKE_BASELINES: tuple[Algorithm, ...] = ("paper-letter", "mcl", "amcl")
"""In worlds that are symmetric to the last cell, where rays see no more than the field does."""
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
"""Training: constants were chosen on it. Validation: it was looked at while they were. Test: no
choice was ever made on it."""


class AfterStep(msgspec.Struct, frozen=True):
    """The robot is lifted elsewhere after this step; the first step is 0."""

    step: int


class OnceRight(msgspec.Struct, frozen=True):
    """The robot is lifted elsewhere once the estimate was right 40 times in a row."""

    at_latest: int
    """Or after so many updates, right or not."""


class SimulatedRobot(msgspec.Struct, frozen=True, kw_only=True):
    """A simulated robot."""

    world: str
    """Name of a world, or a map file."""
    map: Path | None = None
    """What the localizer is given; None: the world's own map."""
    people: int = 0
    """People who walk about near the robot."""
    kidnapping: AfterStep | OnceRight | None = None


class RecordedRobot(msgspec.Struct, frozen=True, kw_only=True):
    """A robot that was recorded."""

    recording: Path
    map: Path
    reference: Path | None
    """Where it really was; None: nobody knows, and no update is judged."""


class Case(msgspec.Struct, frozen=True, kw_only=True):
    """One experiment."""

    name: str
    """What a person types."""
    title: str
    """One line about it."""
    robot: SimulatedRobot | RecordedRobot
    updates: int | None = None
    """At most this many a run; None: to the recording's end."""
    updates_after_event: int | None = None
    """A run ends this long after the feature was seen or the robot was kidnapped."""
    role: Role = "validation"
    """Of its building, in the choice of the defaults."""
    seeds: int
    """Runs of each algorithm by default; all have the same seeds."""
    baselines: tuple[Algorithm, ...] = BASELINES
    """Algorithms that run beside Cluster-MCL."""
    symmetry: int = 1
    """The map is k-fold symmetric, or nearly so."""
    has_feature: bool = False
    """Something in the map tells the symmetric poses apart."""
    mirrored: bool = False
    """The robot of a mirror-image building, which is nowhere in the map; no update is judged."""
    settings: tuple[str, ...] = ()
    """Settings that belong to the experiment, `section.key=value`."""

    @property
    def algorithms(self) -> tuple[Algorithm, ...]:
        """All that run, Cluster-MCL first."""
        return ("cluster-mcl", *self.baselines)


def algorithm_named(name: str) -> Algorithm:
    """An algorithm by its name.

    Raises:
        SettingsError: there is none of that name.
    """
    for algorithm in ALGORITHMS:
        if algorithm == name:
            return algorithm
    problem = f"--algorithm {name}: there is {' or '.join(ALGORITHMS)}"
    raise SettingsError(key="--algorithm", problem=problem)
