from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.experiments.case import AfterStep, Algorithm, Case, SimulatedRobot
from benchmarks.experiments.mcl import AMCL_GAINS, SHRINKING_STEPS, OrdinaryMCL
from benchmarks.experiments.measures import RunMeasures
from benchmarks.experiments.task import Task, run_task
from clustermcl.filter.cluster.cluster_filter import ParticleSet
from clustermcl.filter.settings import BeliefSettings, FilterSettings
from clustermcl.runtime.settings_file import load_settings
from tests.unit.filter.rooms import model_of, plain_room

SMALL = ["belief.max_clusters=3", "belief.particles=0"]
ROOM = model_of(plain_room())
SETTINGS = FilterSettings(belief=BeliefSettings(max_clusters=2, particles=0))


def task(algorithm: Algorithm, cache: Path, *more: str, **changed: Any) -> Task:
    robot = SimulatedRobot(world="hall", kidnapping=changed.pop("kidnapping", None))
    case = Case(name="t", title="t", robot=robot, seeds=1, **changed)
    settings = load_settings(None, [*SMALL, *more])
    return Task(case=case, algorithm=algorithm, seed=3, settings=settings, cache_folder=cache)


def kidnapped(algorithm: Algorithm, cache: Path) -> RunMeasures:
    after_20 = task(algorithm, cache, updates=80, kidnapping=AfterStep(20))
    return run_task(after_20).measures


def test_a_kidnapped_robot_is_found_again_only_with_random_particles(tmp_path: Path) -> None:
    with_recovery, without = (
        kidnapped("amcl-tuned", tmp_path),
        kidnapped("mcl-visibility", tmp_path),
    )
    assert with_recovery.right_after_kidnap is not None
    assert with_recovery.localized
    assert without.right_within is not None
    assert without.right_after_kidnap is None


def drawn(before: ParticleSet, random_share: float) -> ParticleSet:
    """Return what resampling makes of a set once it has shrunk."""
    followed = OrdinaryMCL(ROOM, SETTINGS, AMCL_GAINS)
    followed.steps = SHRINKING_STEPS
    assert followed._recovery is not None
    followed._recovery._slow, followed._recovery._fast = 1.0, 1.0 - random_share
    return followed.redrawn(before, np.random.default_rng(7))


def test_the_random_share_of_a_particle_set_is_drawn_from_the_whole_map() -> None:
    before = ParticleSet.even(np.tile((1.0, 1.0, 0.5), (2000, 1)))
    after = drawn(before, 0.25)
    moved = np.any(after.map_from_robot != before.map_from_robot, axis=1)
    # 2000 draws of probability 0.25: six standard deviations are 0.058, missed once in 5e8
    assert moved.mean() == pytest.approx(0.25, abs=0.058)
    assert np.ptp(after.map_from_robot[moved], axis=0) == pytest.approx([5.9, 3.9, 6.28], abs=0.3)
    assert (after.weights == 1.0 / 2000).all()
    assert drawn(before, 0.0) is before
