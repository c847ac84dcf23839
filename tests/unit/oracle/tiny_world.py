"""A room of a few metres, a short drive in it, and the real filter sent along with the oracle."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from clustermcl.belief.ensemble import Ensemble
from clustermcl.belief.outcome import Outcome
from clustermcl.filter.arrays import OCCUPIED, UNKNOWN, Cells
from clustermcl.filter.grid import Grid
from clustermcl.filter.laser.sensor_model import computed_model
from clustermcl.filter.poses import compose
from clustermcl.filter.settings import (
    ClusterSettings,
    FilterSettings,
    MotionSettings,
    SearchSettings,
    SensorSettings,
)
from clustermcl.jobs.jobs import RunningJob, running
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.found_places import FoundPlaces
from clustermcl.protocol.pose_arrays import pose_tuple
from clustermcl.protocol.steps import Scan
from clustermcl.protocol.work import Assignment, ElsewhereJob, TrackReport
from tests.unit.coordinator.reports import literal_bayes, searched
from tests.unit.coordinator.reports import scan as scan_of
from tests.unit.filter.naive_rays import cast_rays
from tests.unit.oracle.grid_filter import Array, ExactField, GridFilter

CELL_M = 0.05
ANGLES = np.linspace(-np.pi, np.pi, 12, endpoint=False)
MOTION = MotionSettings(
    turn_noise_per_turn=0.3,
    turn_noise_per_metre=0.4,
    drive_noise_per_metre=0.4,
    drive_noise_per_turn=0.8,
    strafe_noise_per_metre=0.3,
)
SENSOR = SensorSettings(scan_likelihood_exponent=0.3, max_beams=len(ANGLES), hit_sigma_m=0.2)
DRIVE = np.array([0.15, 0.02, 0.06])
"""What odometry says of every step, in the robot's frame."""
SPREAD = np.array([0.08, 0.06, 0.05])
"""Standard deviations at the start of every place: x, y [m], heading [rad]."""
HANDED_OVER = 2000
"""Particles in the sample that a cluster is handed."""
ELSEWHERE_POSES = 20_000
"""The logarithm of their average likelihood is less than 0.01 too small."""


def symmetric_room() -> Cells:
    """6 m x 4 m in half a metre of the unknown; half a turn maps it on itself."""
    cells = np.zeros((80, 120), np.int8)
    cells[[0, -1], :] = cells[:, [0, -1]] = OCCUPIED
    cells[20:28, 52:58] = OCCUPIED
    return np.pad(np.maximum(cells, cells[::-1, ::-1]), 10, constant_values=UNKNOWN)


def plain_room() -> Cells:
    """The same with a cabinet in one corner."""
    cells = symmetric_room()
    cells[11:22, 11:22] = OCCUPIED
    return cells


TRUTH = np.array([1.8, 2.2, 0.2])
MIRRORED = np.array([7.0 - TRUTH[0], 5.0 - TRUTH[1], TRUTH[2] + np.pi])


class Drive:
    """What the robot measures: a scan a step, from where it truly is."""

    def __init__(self, cells: Cells, start: Array, steps: int, first_step: int = 1) -> None:
        pose, odom, self.scans = start, np.zeros(3), list[Scan]()
        self.hits = list[NDArray[np.float64]]()
        for step in range(first_step, first_step + steps):
            if step > 0:
                pose, odom = compose(pose, DRIVE), compose(odom, DRIVE)
            ranges = cast_rays(cells, CELL_M, pose, ANGLES, 20.0).astype(np.float32)
            self.scans.append(_scan(step, odom, ranges))
            self.hits.append(np.stack([ranges * np.cos(ANGLES), ranges * np.sin(ANGLES)], axis=-1))


def _scan(step: int, odom: Array, ranges: NDArray[np.float32]) -> Scan:
    return replace(
        scan_of(step),
        odom_from_robot=pose_tuple(odom),
        angle_min_rad=float(ANGLES[0]),
        angle_step_rad=float(ANGLES[1] - ANGLES[0]),
        range_max_m=20.0,
        ranges=ArrayBlob.of(ranges, "float32"),
    )


def settings(
    seed: int, particles: int = 2000, *, reach_m: float = 0.2, **belief: object
) -> FilterSettings:
    rules = {
        "max_clusters": 4, "search_every_steps": 1000,
        "elsewhere_poses": ELSEWHERE_POSES, "lost_probability": 1.0, **belief,
    }  # fmt: skip
    return FilterSettings(
        seed=seed,
        motion=MOTION,
        sensor=SENSOR,
        cluster=ClusterSettings(particles=particles, view_distance_m=0.0),
        search=SearchSettings(shards=1, source_radius_m=reach_m),
        belief=literal_bayes(**rules),
    )


def ensemble_steps(
    cells: Cells,
    drive: Drive,
    places: Sequence[tuple[float, Array]],
    given: FilterSettings,
    *,
    missing: Mapping[int, str] | None = None,
) -> Iterator[tuple[Outcome, dict[str, TrackReport]]]:
    """The product: an `Ensemble` and the jobs that it begins, step by step.

    Places are probability and mean pose of what the search is said to have found; `missing` has,
    by step, the job whose report is lost.
    """
    model = computed_model(Grid(cells, CELL_M, np.zeros(3)), given.sensor)
    rng = np.random.default_rng(given.seed + 1000)
    ensemble = Ensemble.of(given)
    begin = ensemble.begin_at(0)
    found = _places(places, rng)
    shards = range(given.search.shards)
    search = [replace(searched(f"s0.{shard}", 0, {}), places=found) for shard in shards]
    outcome = ensemble.advance(0, search)
    standing = {job_id: job for job_id, job in begin.items() if isinstance(job, ElsewhereJob)}
    jobs: dict[str, RunningJob] = {}
    for scan in drive.scans:
        for job_id, job in (standing | outcome.begin).items():
            order = Assignment(job_id=job_id, epoch=0, job=job)
            jobs[job_id] = running(order, model, given, sender="w")
        standing = {}
        for job_id in outcome.end:
            jobs.pop(job_id, None)
        reports = {job_id: job.advance(scan) for job_id, job in jobs.items()}
        lost = (missing or {}).get(scan.step)
        received = [report for job_id, report in reports.items() if job_id != lost]
        outcome = ensemble.advance(scan.step, received, DRIVE)
        yield outcome, {j: r for j, r in reports.items() if isinstance(r, TrackReport)}


PATCH_CELL = np.array([0.0411, 0.0411, 0.0357])
"""Of the exact grid round a place: x, y [m], heading [rad]."""


def exact_patch(mean: Array) -> GridFilter:
    """The grid where a cluster starts: its sample's Gaussian, spread by the hand-over's kernel."""
    kernel = 0.5 * (4.0 / 5.0) ** (1.0 / 7.0) * HANDED_OVER ** (-1.0 / 7.0)
    reach = np.array([1.2, 1.2, 0.4])  # the heading turns one way
    return GridFilter.round_gaussian(
        mean,
        SPREAD**2 * (1.0 + kernel**2),
        mean - reach,
        mean + reach + [0.0, 0.0, 0.5],
        PATCH_CELL,
    )


def exact_evidence(cells: Cells, drive: Drive, patch: GridFilter) -> list[float]:
    """Log evidence of every step."""
    field, exponent = ExactField(cells, CELL_M, SENSOR), SENSOR.scan_likelihood_exponent
    evidence = []
    for hits in drive.hits:
        patch.move(DRIVE, MOTION)
        evidence.append(patch.weigh(field, hits, exponent))
    return evidence


def exact_everywhere(cells: Cells) -> GridFilter:
    """The grid that knows nothing but the free space."""
    rows, cols = cells.shape
    made = GridFilter(
        np.arange(0.5 * CELL_M, cols * CELL_M, CELL_M),
        np.arange(0.5 * CELL_M, rows * CELL_M, CELL_M),
        np.arange(-np.pi, np.pi - 1e-9, 2.0 * np.pi / 90),
    )
    made.mass = np.repeat((cells.T == 0).astype(float)[:, :, None], 90, axis=2)
    made.mass /= made.mass.sum()
    return made


def exact_elsewhere(cells: Cells, drive: Drive) -> list[float]:
    """Log evidence of every step, wherever the robot may be at each."""
    field, exponent = ExactField(cells, CELL_M, SENSOR), SENSOR.scan_likelihood_exponent
    return [exact_everywhere(cells).weigh(field, hits, exponent) for hits in drive.hits]


def _places(given: Sequence[tuple[float, Array]], rng: np.random.Generator) -> FoundPlaces:
    covariance = np.diag(SPREAD**2)
    return FoundPlaces.of(
        (0.0, 0.0, 0.0),
        [share for share, _ in given],
        [mean for _, mean in given],
        [covariance for _ in given],
        [mean + rng.normal(size=(HANDED_OVER, 3)) * SPREAD for _, mean in given],
    )
