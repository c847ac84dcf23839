"""The benchmark cases: each kernel next to plain numpy and C, on the same data."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from benchmarks import floor, plain
from clustermcl.belief import log_probabilities as belief
from clustermcl.filter.arrays import OCCUPIED, Cells, Points, Poses
from clustermcl.filter.cluster.gaussian import fit_gaussian
from clustermcl.filter.grid import Grid
from clustermcl.filter.laser.likelihood_field import LikelihoodField, scan_log_likelihood
from clustermcl.filter.laser.ray_casting import cast_rays_from_poses, jump_field
from clustermcl.filter.motion.model import move, standard_normals
from clustermcl.filter.motion.noise import along_across_turn
from clustermcl.filter.resampling import resample, systematic
from clustermcl.filter.search.places import cluster_by_source_point
from clustermcl.filter.settings import MotionSettings, SensorSettings
from clustermcl.simulator.worlds.catalogue import world

Run = Callable[[], object]
SIDE, CELL_M = 800, 0.05
MAX_RANGE_M = 30.0
CENTRE = np.array([20.0, 17.9])
"""A corridor's middle."""


@dataclass(frozen=True)
class Case:
    """One piece of work, done in up to three ways."""

    name: str
    unit: str
    units: int
    """How many units one run does: times are reported per unit."""
    ours: Run
    plain: Run | None = None
    floor: Run | None = None
    check: Callable[[], None] = lambda: None
    """Fails if the ways do not agree."""


@cache
def cells() -> Cells:
    """800 x 800 cells of the simulator's office."""
    whole: Cells = world("office").map.cells
    return np.ascontiguousarray(whole[100 : 100 + SIDE, 100 : 100 + SIDE])


@cache
def field() -> LikelihoodField:
    return LikelihoodField.build(Grid(cells(), CELL_M, np.zeros(3)), SensorSettings())


def cloud(kind: str, count: int) -> Poses:
    """`uniform` over the map in any order or `sorted` by cell, or a `blob` of a metre."""
    rng = np.random.default_rng(count)
    if kind == "blob":
        spread = rng.normal(0.0, [0.25, 0.25, 0.1], (count, 3))
        return np.add(spread, (*CENTRE, 0.3))
    poses = rng.uniform([0.0, 0.0, -np.pi], [SIDE * CELL_M, SIDE * CELL_M, np.pi], (count, 3))
    if kind == "sorted":
        row, col = (poses[:, 1] // 0.5).astype(int), (poses[:, 0] // 0.5).astype(int)
        poses = poses[np.lexsort((poses[:, 2], col, row))]
    return np.ascontiguousarray(poses)


def scan(beams: int) -> tuple[NDArray[np.float64], NDArray[np.float64], Points]:
    """Ranges, angles and end points of a scan from the blob's middle."""
    angles = np.linspace(-np.pi / 2, np.pi / 2, beams)
    pose = np.array([[*CENTRE, 0.3]])
    ranges = cast_rays_from_poses(jump_field(cells()), field().grid, pose, angles, MAX_RANGE_M)[0]
    points = np.stack([ranges * np.cos(angles), ranges * np.sin(angles)], axis=-1)
    return ranges, angles, points


def likelihood(kind: str, count: int, beams: int, compiler: bool) -> Case:
    poses, (_, _, hits), lookup = cloud(kind, count), scan(beams), field()
    sums, hits_32 = np.empty(count, np.uint32), (hits / CELL_M).astype(np.float32)
    in_c = (
        floor.call(
            "summed_codes", poses, count, hits_32, beams, np.ascontiguousarray(lookup.codes),
            SIDE + 2, SIDE + 2, 1.0 / CELL_M, sums,
        )
        if compiler
        else None
    )  # fmt: skip

    def check() -> None:
        ours = scan_log_likelihood(poses, hits, lookup)
        # A hit within rounding of a cell's border falls either way: few, and by one cell.
        close = np.abs(ours - plain.scan_log_likelihood(poses, hits, lookup)) < 1e-3 * beams
        assert close.mean() > 0.98
        if in_c is not None:
            in_c()
            in_floor = beams * lookup.log_floor + lookup.log_step * sums
            assert (np.abs(ours - in_floor) < 1e-3 * beams).mean() > 0.98

    return Case(
        f"likelihood field, {kind}, {count:,} particles, {beams} beams",
        "particle and beam", count * beams,
        lambda: scan_log_likelihood(poses, hits, lookup),
        lambda: plain.scan_log_likelihood(poses, hits, lookup),
        in_c, check,
    )  # fmt: skip


def rays(kind: str, count: int, beams: int, compiler: bool) -> Iterator[Case]:
    """Ray casting against our way in C, and against marching in C."""
    poses, (_, angles, _) = cloud(kind, count), scan(beams)
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    jumps = jump_field(cells())
    clear = distance_transform_edt(cells() != OCCUPIED).astype(np.float32)
    cast_c, marched_c = np.empty((count, beams)), np.empty((count, beams))

    def in_c(name: str, field: NDArray[np.generic], out: NDArray[np.float64]) -> Run | None:
        numbers = SIDE, SIDE, poses, count, directions, beams, CELL_M, MAX_RANGE_M, out
        return floor.call(name, field, *numbers) if compiler else None

    exact, marching = in_c("cast_all", jumps, cast_c), in_c("march_all", clear, marched_c)

    def ours() -> NDArray[np.float64]:
        return cast_rays_from_poses(jumps, field().grid, poses, angles, MAX_RANGE_M)

    def check() -> None:
        if exact is not None and marching is not None:
            exact()
            marching()
            np.testing.assert_allclose(ours(), cast_c, atol=1e-6)
            assert (np.abs(ours() - marched_c) < 2 * CELL_M).mean() > 0.95  # it cuts corners

    def in_numpy() -> object:
        return plain.cast_rays(clear, CELL_M, poses, directions, MAX_RANGE_M)

    about = f"{kind}, {count:,} particles, {beams} beams"
    units = "ray", count * beams
    yield Case(f"rays, floor: the same in C, {about}", *units, ours, in_numpy, exact, check)
    yield Case(f"rays, floor: marching in C, {about}", *units, ours, in_numpy, marching)


def motion(count: int, compiler: bool) -> Iterator[Case]:
    poses, settings = cloud("blob", count), MotionSettings()
    drive = np.array([0.2, 0.01, 0.05])
    rng = np.random.default_rng(1)
    noise = standard_normals(rng, 3, count)
    numbers = np.array(along_across_turn(drive, settings))
    moved = np.empty((count, 3))
    in_c = floor.call("drive", poses, count, noise, numbers, moved) if compiler else None

    def check() -> None:
        ours = move(poses, drive, settings, noise)
        np.testing.assert_allclose(ours, plain.drive(poses, numbers, noise), atol=1e-6)
        if in_c is not None:
            in_c()
            np.testing.assert_allclose(ours, moved, atol=1e-6)

    yield Case(
        f"motion, noise given, {count:,} particles", "particle", count,
        lambda: move(poses, drive, settings, noise),
        lambda: plain.drive(poses, numbers, noise), in_c, check,
    )  # fmt: skip
    yield Case(
        f"motion, noise drawn; floor: noise given, {count:,} particles", "particle", count,
        lambda: move(poses, drive, settings, standard_normals(rng, 3, count)),
        lambda: plain.drive(poses, numbers, rng.standard_normal((3, count))), in_c,
    )  # fmt: skip


def resampling(count: int, compiler: bool) -> Iterator[Case]:
    log_weights = np.random.default_rng(count).normal(size=count)
    weights = np.exp(log_weights) / np.exp(log_weights).sum()
    first = np.random.default_rng(2).random()
    picked = np.empty(count, np.int64)
    in_c = floor.call("pick", weights, count, first, picked) if compiler else None

    def check() -> None:
        ours = resample(log_weights, count, np.random.default_rng(2))
        # Sums round differently: a position on a border falls either way.
        assert (np.abs(ours - plain.resample(log_weights, first)) <= 1).all()
        if in_c is not None:
            in_c()
            assert (np.abs(ours - picked) <= 1).all()

    rng = np.random.default_rng(3)
    yield Case(
        f"resampling, weights given, {count:,} particles", "particle", count,
        lambda: systematic(weights, count, rng.random()),
        None, in_c, check,
    )  # fmt: skip
    yield Case(
        f"resampling, log-weights given; floor: weights, {count:,} particles", "particle", count,
        lambda: resample(log_weights, count, rng),
        lambda: plain.resample(log_weights, first), in_c,
    )  # fmt: skip


def gaussian(count: int, compiler: bool) -> Case:
    poses = cloud("blob", count)
    weights = np.random.default_rng(4).random(count)
    weights /= weights.sum()
    mean, covariance = np.empty(3), np.empty(6)
    in_c = floor.call("gaussian", poses, weights, count, mean, covariance) if compiler else None

    def check() -> None:
        our_mean, our_covariance = fit_gaussian(poses, weights)
        for theirs, expected in zip(
            plain.fit_gaussian(poses, weights), (our_mean, our_covariance), strict=True
        ):
            np.testing.assert_allclose(theirs, expected, atol=1e-9)
        if in_c is not None:
            in_c()
            np.testing.assert_allclose(mean, our_mean, atol=1e-9)
            upper = our_covariance[np.triu_indices(3)]
            np.testing.assert_allclose(covariance, upper, atol=1e-9)

    return Case(
        f"Gaussian fit, {count:,} particles", "particle", count,
        lambda: fit_gaussian(poses, weights),
        lambda: plain.fit_gaussian(poses, weights), in_c, check,
    )  # fmt: skip


def clustering(count: int) -> Case:
    centres = np.random.default_rng(5).uniform(0.0, 40.0, (20, 3))
    poses = centres[np.arange(count) % 20] + np.random.default_rng(6).normal(0, 0.1, (count, 3))
    log_weights = np.random.default_rng(7).normal(size=count)
    numbers = poses, log_weights, 1.0, 0.5, 500

    def check() -> None:
        ours, _ = cluster_by_source_point(*numbers)
        np.testing.assert_array_equal(ours, plain.cluster_by_source_point(*numbers))

    return Case(
        f"source clustering, 20 places, {count:,} particles", "particle", count,
        lambda: cluster_by_source_point(*numbers),
        lambda: plain.cluster_by_source_point(*numbers), None, check,
    )  # fmt: skip


def belief_update(clusters: int) -> Case:
    rng = np.random.default_rng(8)
    prior, evidence = rng.random(clusters), rng.normal(size=clusters)
    prior /= prior.sum()
    log_prior = np.log(prior)

    def check() -> None:
        ours = np.exp(belief.updated(log_prior, evidence))
        np.testing.assert_allclose(ours, plain.updated_belief(prior, evidence), rtol=1e-9)

    return Case(
        f"belief update, {clusters} clusters", "cluster", clusters,
        lambda: belief.updated(log_prior, evidence),
        lambda: plain.updated_belief(prior, evidence), None, check,
    )  # fmt: skip


def all_cases() -> Iterator[Case]:
    """Every case; without floors where there is no C compiler."""
    try:
        compiler = bool(floor.library())
    except floor.NoCompilerError:
        compiler = False
    for kind in ("uniform", "sorted", "blob"):
        for count in (1_000, 10_000, 100_000):
            for beams in (60, 181):
                yield likelihood(kind, count, beams, compiler)
    for kind in ("blob", "uniform"):
        yield from rays(kind, 2_000, 60, compiler)
    for count in (1_000, 100_000):
        yield from motion(count, compiler)
        yield from resampling(count, compiler)
        yield gaussian(count, compiler)
    yield clustering(50_000)
    yield belief_update(10)
