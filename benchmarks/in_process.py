"""Whole steps of the filter in one process, of any size: ten clusters at places of their own."""

from collections.abc import Iterator

import numpy as np

from benchmarks.cases import CELL_M, CENTRE, cells
from clustermcl.belief import log_probabilities as belief
from clustermcl.filter.grid import Grid
from clustermcl.filter.laser.beam_fits import decoded
from clustermcl.filter.laser.ray_casting import cast_rays_from_poses, jump_field
from clustermcl.filter.laser.sensor_model import SensorModel, computed_model
from clustermcl.filter.settings import ClusterSettings, FilterSettings, SensorSettings
from clustermcl.jobs.jobs import RunningJob, running
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.steps import Scan
from clustermcl.protocol.work import Assignment, Particles, TrackJob


def steps(
    clusters: int = 10, particles: int = 1_000, beams: int = 60, tiles: int = 1
) -> Iterator[np.ndarray]:
    """Endless steps, a belief each; every cluster tracks a robot that shakes in one place.

    Args:
        clusters: tracked, two of three of them in a wrong place.
        particles: of each.
        beams: scored of a scan of 181, or as many as there are.
        tiles: factor for the width and height of the map.
    """
    settings = FilterSettings(
        cluster=ClusterSettings(particles=particles), sensor=SensorSettings(max_beams=beams)
    )
    grid = np.tile(cells(), (tiles, tiles))
    ground = Grid(grid, CELL_M, np.zeros(3))
    model = computed_model(ground, settings.sensor)
    rng = np.random.default_rng(0)
    free = np.argwhere(grid == 0)
    jobs = [_job(number, _place(number, free, rng), model, settings) for number in range(clusters)]
    log_belief = np.full(clusters, -np.log(clusters))
    angles = np.linspace(-np.pi / 2, np.pi / 2, max(beams, 181))
    seen_m = cast_rays_from_poses(jump_field(grid), ground, _TRUE_POSE, angles, 30.0)[0]
    step = 1
    while True:
        scan = _scan(step, seen_m + rng.normal(0.0, 0.02, len(seen_m)), angles)
        reports = [job.advance(scan) for job in jobs]
        beams = np.full(len(reports[0].fits), settings.belief.piece_evidence / 10)
        evidence = np.array([decoded(report.fits)[0] @ beams for report in reports])
        log_belief = belief.updated(log_belief, evidence)
        yield log_belief
        step += 1


_TRUE_POSE = np.array([[*CENTRE, 0.3]])


def _place(number: int, free: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    if number % 3 == 0:
        return _TRUE_POSE[0]
    row, col = free[rng.integers(len(free))]
    return np.array([col * CELL_M, row * CELL_M, rng.uniform(-np.pi, np.pi)])


def _job(
    number: int, place: np.ndarray, model: SensorModel, settings: FilterSettings
) -> RunningJob:
    spread = np.random.default_rng(number).normal(0.0, [0.1, 0.1, 0.05], (500, 3))
    start = Particles(
        step=0,
        odom_from_robot=(0.0, 0.0, 0.0),
        map_from_robot=ArrayBlob.of(place + spread, "float64"),
        log_weights=ArrayBlob.of(np.zeros(500), "float64"),
    )
    job = TrackJob(cluster=number, start=start, exact=False)
    assignment = Assignment(job_id=f"c{number}", epoch=0, job=job)
    return running(assignment, model, settings, sender="benchmark")


def _scan(step: int, ranges: np.ndarray, angles: np.ndarray) -> Scan:
    return Scan(
        sender="benchmark", step=step, stamp_ns=step,
        odom_from_robot=(0.1 * (step % 2), 0.0, 0.05 * (step % 2)),
        robot_from_laser=(0.0, 0.0, 0.0), angle_min_rad=float(angles[0]),
        angle_step_rad=float(angles[1] - angles[0]), range_max_m=30.0,
        ranges=ArrayBlob.of(ranges, "float32"), map_digest="",
    )  # fmt: skip
