import numpy as np
import pytest

from benchmarks.experiments.mcl import AMCL_GAINS, SHRINKING_STEPS, OrdinaryMCL
from clustermcl.filter.cluster.cluster_filter import ParticleSet
from clustermcl.filter.settings import BeliefSettings, FilterSettings
from tests.unit.filter.rooms import model_of, plain_room

ROOM = model_of(plain_room())
SETTINGS = FilterSettings(belief=BeliefSettings(max_clusters=2, particles=0))


def drawn(before: ParticleSet, random_share: float) -> ParticleSet:
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
