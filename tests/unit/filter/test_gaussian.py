import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from clustermcl.filter.arrays import Poses
from clustermcl.filter.cluster.gaussian import fit_gaussian, fit_gaussians, share_near_mean
from tests.unit.filter import naive

clouds = arrays(np.float64, (6, 3), elements=st.floats(-1, 1))
weights = arrays(np.float64, 6, elements=st.floats(0.1, 10))


@given(cloud=clouds, weight=weights)
def test_the_fitted_gaussian_agrees_with_sums_written_out(
    cloud: Poses, weight: NDArray[np.float64]
) -> None:
    for found, expected in zip(
        fit_gaussian(cloud, weight), naive.fit_gaussian(cloud, weight), strict=True
    ):
        np.testing.assert_allclose(found, expected, atol=1e-12)


def test_the_mean_heading_across_the_seam_is_near_the_seam_and_wrapped() -> None:
    cloud = np.array([[0.0, 0.0, np.radians(179.0)], [0.0, 0.0, np.radians(-177.0)]])
    mean, covariance = fit_gaussian(cloud, np.ones(2))
    assert mean[2] == pytest.approx(np.radians(-179.0))
    assert covariance[2, 2] == pytest.approx(np.radians(2.0) ** 2)


def test_one_particle_is_its_own_mean_whatever_lies_behind_it_in_memory() -> None:
    memory = np.array([[1.0, 2.0, 3.0], [np.nan, np.nan, np.nan]])
    mean, covariance = fit_gaussian(memory[:1], np.ones(1))
    np.testing.assert_array_equal(mean, [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(covariance, np.zeros((3, 3)))


@pytest.mark.parametrize("weight", [[0.0, 0.0], [np.nan, 1.0], [np.inf, 1.0]])
def test_weights_that_sum_to_nothing_are_refused(weight: list[float]) -> None:
    with pytest.raises(ValueError, match="fit no Gaussian"):
        fit_gaussian(np.zeros((2, 3)), np.array(weight))


def test_the_gaussian_of_a_part_equals_that_of_its_particles_alone() -> None:
    rng = np.random.default_rng(3)
    poses, weights = rng.normal(0.0, 2.0, (50, 3)), rng.exponential(1.0, 50)
    weights[40:45] = 0.0
    ends = np.array([0, 1, 40, 40, 45, 50])  # one pose, many, none, some without weight, five
    totals = np.array([weights[first:end].sum() for first, end in pairwise(ends)])
    means, covariances = fit_gaussians(poses, weights, ends, totals)
    for part in (0, 1, 4):
        own = slice(ends[part], ends[part + 1])
        mean, covariance = fit_gaussian(poses[own], weights[own])
        np.testing.assert_allclose(means[part], mean, atol=1e-12)
        np.testing.assert_allclose(covariances[part], covariance, atol=1e-12)
    assert np.isfinite(means).all()
    assert np.isfinite(covariances).all()


def test_the_share_near_the_mean_is_that_of_drawn_poses() -> None:
    turned, spread = np.radians(35.0), np.array([1.3, 0.6, 0.4])
    c, s = np.cos(turned), np.sin(turned)
    axes = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    covariance = axes @ np.diag(spread**2) @ axes.T
    drawn = np.random.default_rng(1).standard_normal((100_000, 3)) * spread
    near = (np.abs(drawn) < [1.0, 1.0, 0.5]).all(axis=1).mean()
    # The standard error is 0.0016; four times that.
    assert share_near_mean(covariance.ravel().tolist(), 1.0, 0.5) == pytest.approx(near, abs=6e-3)


@pytest.mark.parametrize("variance", [0.0, -1.0, 1e-300])
def test_a_cloud_without_width_is_near_its_mean(variance: float) -> None:
    assert share_near_mean([variance] * 9, 1.0, 0.5) == 1.0


def test_no_width_is_too_large_and_no_reach() -> None:
    assert share_near_mean([1e308] * 9, 1.0, 0.5) == pytest.approx(0.0, abs=1e-100)
    assert share_near_mean(np.eye(3).ravel().tolist(), math.inf, math.inf) == 1.0
