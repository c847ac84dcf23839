import math
from dataclasses import replace

import numpy as np
import pytest

from clustermcl.filter.grid import Grid
from clustermcl.filter.observations.fixes import PoseFix, PositionFix
from clustermcl.filter.observations.kind import Kind, Landmarks
from clustermcl.filter.observations.likelihood import allowed_poses, log_likelihood_ratio
from clustermcl.filter.observations.sighting import Sighting
from clustermcl.filter.poses import between, compose
from tests.unit.oracle.grid_filter import Array

GRID = Grid(np.zeros((160, 200), np.int8), 0.05, np.zeros(3))
AREA_M2, SIGHT_M2 = 10.0 * 8.0, math.pi * 100.0
LANDMARKS = Landmarks(
    ("door", "door", "tag"),
    np.array([[3.0, 3.0], [7.0, 5.0], [5.0, 4.0]]),
    np.array([0.01, 0.02, 0.005]),
)
TILTED = np.array([[0.09, 0.02], [0.02, 0.04]])
TILTED_POSE = np.array([[0.2, 0.03, 0.05], [0.03, 0.1, -0.04], [0.05, -0.04, 0.3]])
KINDS: dict[str, Kind] = {
    "pose": PoseFix(np.array([4.0, 3.0, 0.5]), TILTED_POSE, 0.1),
    "position": PositionFix(np.array([4.0, 3.0]), TILTED, 0.05),
    "id": Sighting(np.array([1.2, 0.5]), TILTED, 0.05, landmark="tag"),
    "class": Sighting(np.array([1.5, -0.3]), TILTED, 0.2, landmark="door"),
}


def density(difference: Array, covariance: Array) -> float:
    squares = difference @ np.linalg.solve(covariance, difference)
    return float(np.exp(-0.5 * squares) / np.sqrt(np.linalg.det(2.0 * np.pi * covariance)))


def exact_ratio(pose: Array, seen: Kind) -> float:
    """The mixture as the page of docs describes it, one term after the other."""
    eps = seen.outlier_probability
    if not isinstance(seen, Sighting):
        off = pose[: len(seen.mean)] - seen.mean
        if len(off) == 3:
            off[2] = math.remainder(off[2], math.tau)
        nothing = eps / AREA_M2 / (math.tau if len(off) == 3 else 1.0)
        return ((1.0 - eps) * density(off, seen.covariance) + nothing) / nothing
    names = len(set(LANDMARKS.names))
    nothing = eps / 2.0 / names / SIGHT_M2
    total = nothing
    columns = LANDMARKS.names, LANDMARKS.positions, LANDMARKS.variances
    for name, place, variance in zip(*columns, strict=True):
        at = between(pose, np.append(place, 0.0))[:2]
        here = density(at - seen.mean, seen.covariance + variance * np.eye(2))
        total += eps / 2.0 / names * here + (1.0 - eps) * here * (name == seen.landmark)
    return total / nothing


@pytest.mark.parametrize("kind", ["position", "id"])
def test_poses_are_drawn_of_a_covariance_as_lopsided_as_messages_may_have_it(kind: str) -> None:
    lopsided = replace(KINDS[kind], covariance=np.array([[1.0, 5e-7], [0.0, 1.0]]))
    assert np.isfinite(lopsided.draw(LANDMARKS, GRID, 100, np.random.default_rng(1))).all()


@pytest.mark.parametrize("kind", KINDS)
def test_the_ratio_at_a_pose_is_that_of_the_mixture(kind: str) -> None:
    poses = np.random.default_rng(1).uniform((0, 0, -4), (10, 8, 4), (200, 3))
    ratios = log_likelihood_ratio(poses, [KINDS[kind]], LANDMARKS, GRID)
    expected = [math.log(exact_ratio(pose, KINDS[kind])) for pose in poses]
    np.testing.assert_allclose(ratios, expected, rtol=1e-12, atol=1e-12)
    alone = [log_likelihood_ratio(pose[None], [KINDS[kind]], LANDMARKS, GRID) for pose in poses]
    np.testing.assert_allclose(np.ravel(alone), expected, rtol=1e-12, atol=1e-12)
    shared = [replace(KINDS[kind], share=share) for share in (0.7, 0.02)]
    both = log_likelihood_ratio(poses, shared, LANDMARKS, GRID)
    np.testing.assert_allclose(both, 0.72 * np.array(expected), rtol=1e-12, atol=1e-12)
    false = [KINDS[kind].outlier_probability_at(pose, LANDMARKS, GRID) for pose in poses]
    assert -np.log(false) == pytest.approx(ratios, abs=1e-9)


@pytest.mark.parametrize("kind", ["id", "class"])
@pytest.mark.parametrize("covariance", [TILTED, 4.0 * np.eye(2)], ids=["sharp", "vague"])
def test_a_pose_has_the_same_ratio_among_poses_that_look_another_way(
    kind: str, covariance: Array
) -> None:
    """Landmarks that are out of sight of all poses together are left out."""
    rng, far = np.random.default_rng(2), np.array([4.0, -2.0])
    seen = replace(KINDS[kind], mean=far, covariance=covariance)
    for place in rng.uniform((0, 0, -4), (10, 8, 4), (50, 3)):
        poses = place + rng.normal(0.0, (0.02, 0.02, 0.2), (8, 3))
        poses[0, 2] = rng.uniform(-4, 4)
        together = log_likelihood_ratio(poses, [seen], LANDMARKS, GRID)
        expected = [math.log(exact_ratio(pose, seen)) for pose in poses]
        np.testing.assert_allclose(together, expected, rtol=1e-12, atol=1e-12)


BLURS = {
    "pose": TILTED_POSE + np.diag([0.09, 0.09, 0.04]),
    "position": TILTED + 0.09 * np.eye(2),
    "id": TILTED + (0.09 + 0.04 * 1.69) * np.eye(2),
    "class": TILTED + (0.09 + 0.04 * 2.34) * np.eye(2),
}


@pytest.mark.parametrize("kind", KINDS)
def test_for_poses_of_a_neighbourhood_an_observation_is_less_certain(kind: str) -> None:
    """An error of the heading displaces a landmark in proportion to its distance."""
    np.testing.assert_allclose(KINDS[kind].blurred(0.3, 0.2).covariance, BLURS[kind], rtol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_an_observation_says_nothing_of_a_pose_that_is_infinitely_far(kind: str) -> None:
    far = np.array([[1e300, -1e300, 0.3]])
    assert log_likelihood_ratio(far, [KINDS[kind]], LANDMARKS, GRID) == [0.0]


@pytest.mark.parametrize("kind", KINDS)
def test_the_average_over_the_map_is_that_of_poses_spread_over_it(kind: str) -> None:
    poses = np.random.default_rng(2).uniform((0, 0, -np.pi), (10, 8, np.pi), (200_000, 3))
    ratios = np.exp(log_likelihood_ratio(poses, [KINDS[kind]], LANDMARKS, GRID))
    average = math.exp(KINDS[kind].log_average_ratio(LANDMARKS, GRID))
    # Sights are short: a landmark near the edge of the map would be seen from fewer poses.
    assert average == pytest.approx(ratios.mean(), rel=0.15)


BEST = {
    "pose": (4.0, 3.0, 0.5),
    "position": (4.0, 3.0, 0.0),
    "id": (3.8, 3.5, 0.0),
    "class": (1.5, 3.3, 0.0),
}


@pytest.mark.parametrize("kind", KINDS)
def test_the_largest_ratio_is_that_of_the_pose_which_it_fits_best(kind: str) -> None:
    best = math.log(exact_ratio(np.array(BEST[kind]), KINDS[kind]))
    # At the best pose of one landmark, others add a little.
    assert KINDS[kind].largest_log_ratio(LANDMARKS, GRID) == pytest.approx(best, abs=1e-3)


@pytest.mark.parametrize("kind", KINDS)
def test_an_observation_is_as_informative_however_much_of_it_is_new(kind: str) -> None:
    old = replace(KINDS[kind], share=0.1)
    new = KINDS[kind].informativeness(LANDMARKS, GRID)
    assert old.informativeness(LANDMARKS, GRID) == new


def test_poses_are_drawn_from_which_the_landmark_is_seen_where_it_was() -> None:
    tag = Landmarks(("tag",), np.array([[5.0, 4.0]]), np.array([0.05]))
    poses = KINDS["id"].draw(tag, GRID, 100_000, np.random.default_rng(6))
    seen_at = between(poses, np.array([5.0, 4.0, 0.0]))[:, :2]
    # Of 100,000 a mean is known to 0.001 m and a variance to 0.5 % (1 sigma).
    np.testing.assert_allclose(seen_at.mean(axis=0), KINDS["id"].mean, atol=0.005)
    np.testing.assert_allclose(np.cov(seen_at.T), TILTED + 0.05 * np.eye(2), atol=0.003)


@pytest.mark.parametrize("kind", KINDS)
def test_an_observation_moves_with_the_robot(kind: str) -> None:
    seen, motion = KINDS[kind], np.array([0.4, -0.2, 0.7])
    poses = np.random.default_rng(3).uniform((3, 2, -1), (6, 5, 1), (50, 3))
    before = log_likelihood_ratio(poses, [seen], LANDMARKS, GRID)
    after = log_likelihood_ratio(compose(poses, motion), [seen.moved(motion)], LANDMARKS, GRID)
    if kind == "position":  # the direction of the motion is unknown
        assert np.trace(seen.moved(motion).covariance) == pytest.approx(0.13 + 2.0 * 0.2)
    elif kind == "pose":  # so does a sample of its Gaussian, if the heading is well known
        narrow = replace(seen, covariance=np.diag([0.02, 0.01, 0.003]))
        drawn = np.random.default_rng(4).multivariate_normal(seen.mean, narrow.covariance, 100_000)
        sample, moved = compose(drawn, motion), narrow.moved(motion)
        np.testing.assert_allclose(moved.mean, sample.mean(axis=0), atol=0.002)
        np.testing.assert_allclose(moved.covariance, np.cov(sample.T), atol=3e-4)
    else:
        np.testing.assert_allclose(after, before, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_allowed_poses_and_even_poses_estimate_an_average_together(kind: str) -> None:
    """Averages of a function over the free space, weighed by the densities of both kinds."""
    seen, rng = [KINDS[kind]], np.random.default_rng(9)

    def function(poses: Array) -> Array:
        fits = np.cos(poses[:, 2] - 0.4) - 0.1 * np.hypot(poses[:, 0] - 4.0, poses[:, 1] - 3.0)
        return np.exp(log_likelihood_ratio(poses, seen, LANDMARKS, GRID) + fits)

    even = rng.uniform((0, 0, -math.pi), (10, 8, math.pi), (1_000_000, 3))
    average = math.expm1(seen[0].log_average_ratio(LANDMARKS, GRID))
    share = np.expm1(log_likelihood_ratio(even, seen, LANDMARKS, GRID)) / average
    exact = np.mean(function(even) * share / (1.0 + share))
    poses, log_weights = allowed_poses(seen, LANDMARKS, GRID, 100_000, rng)
    assert len(poses) > 50_000
    assert np.sum(np.exp(log_weights) * function(poses)) / 100_000 == pytest.approx(exact, rel=0.03)
