from itertools import product

import numpy as np
import pytest
from msgspec.structs import replace

from clustermcl.filter.arrays import OCCUPIED, UNKNOWN, Cells
from clustermcl.filter.grid import Grid
from clustermcl.filter.laser.sensor_model import computed_model
from clustermcl.filter.settings import FilterSettings, SearchSettings, SensorSettings
from clustermcl.jobs.jobs import running
from clustermcl.protocol.work import Assignment, SearchJob, SearchReport
from tests.unit.coordinator.reports import literal_bayes
from tests.unit.filter.naive import matrix
from tests.unit.oracle.grid_filter import ExactField, assert_is_mean_of
from tests.unit.oracle.tiny_world import CELL_M, DRIVE, MOTION, SENSOR, Drive, exact_everywhere

STEPS, SEEDS, START = 4, range(16), np.array([0.75, 0.85, 0.3])
BLUNT = replace(SENSOR, scan_likelihood_exponent=0.15)
RULES = SearchSettings(shards=2, poses=12_000, source_radius_m=0.15, source_heading_rad=0.3)
GRID_ERROR = 0.02
"""Cells half as wide move the evidence by 0.01 and the share by less."""


def small_room() -> Cells:
    """2 m x 1.5 m and a block at one end: half a turn looks much the same, but not quite."""
    cells = np.zeros((30, 40), np.int8)
    cells[[0, -1], :] = cells[:, [0, -1]] = OCCUPIED
    cells[20:24, 30:36] = OCCUPIED
    return np.pad(cells, 5, constant_values=UNKNOWN)


@pytest.fixture(scope="module")
def drive() -> Drive:
    return Drive(small_room(), START, STEPS, first_step=0)


def exact(drive: Drive) -> tuple[float, float]:
    """Log evidence of all steps, and the share of the belief left of the middle."""
    cells = small_room()
    grid = exact_everywhere(cells)
    field, log_evidence = ExactField(cells, CELL_M, BLUNT), 0.0
    for step, hits in enumerate(drive.hits):
        if step > 0:
            grid.move(DRIVE, MOTION)
        log_evidence += grid.weigh(field, hits, BLUNT.scan_likelihood_exponent)
    return log_evidence, float(grid.mass[grid.xs < 0.5 * cells.shape[1] * CELL_M].sum())


def exact_joined(drive: Drive, exponent: float) -> tuple[float, float]:
    """As `exact`, of all scans at once, placed by odometry as if it did not err."""
    cells = small_room()
    grid, field = exact_everywhere(cells), ExactField(cells, CELL_M, BLUNT)
    robot_from_odom = np.linalg.inv(matrix(drive.scans[-1].odom_from_robot))
    log_likelihood = np.zeros(grid.mass.shape)
    for scan, hits in zip(drive.scans, drive.hits, strict=True):
        in_odom = matrix(scan.odom_from_robot) @ [*hits.T, np.ones(len(hits))]
        from_now = (robot_from_odom @ in_odom)[:2].T
        log_likelihood += field.log_weight(grid.x, grid.y, grid.heading, from_now, exponent)
    mass = grid.mass * np.exp(log_likelihood)
    left_half = mass[grid.xs < 0.5 * cells.shape[1] * CELL_M].sum()
    return float(np.log(mass.sum())), float(left_half / mass.sum())


def found(
    drive: Drive, rules: SearchSettings, sensor: SensorSettings
) -> tuple[list[float], list[float]]:
    """Log evidence of all steps, and the share of the left half, of every seed and shard."""
    evidences, shares = [], []
    model = computed_model(Grid(small_room(), CELL_M, np.zeros(3)), sensor)
    for seed, shard in product(SEEDS, range(rules.shards)):
        settings = FilterSettings(
            seed=seed, motion=MOTION, sensor=sensor, search=rules, belief=literal_bayes()
        )
        search = SearchJob(search=0, shard=shard, first_step=0)
        order = Assignment(job_id=f"s0.{shard}", epoch=0, job=search)
        job = running(order, model, settings, sender="w")
        for scan in drive.scans:
            report = job.advance(scan)
        assert isinstance(report, SearchReport)
        evidences.append(report.log_evidence)
        # A place reaches 0.15 m; those across the middle count by where their mean is.
        middle = 0.5 * small_room().shape[1] * CELL_M
        share, mean = report.places.share.array(), report.places.mean.array()
        shares.append(float(share[mean[:, 0] < middle].sum() / share.sum()))
    return evidences, shares


def test_evidence_and_shares_are_those_of_the_grid(drive: Drive) -> None:
    """Each shard is a filter of its own: 16 seeds are 32 of them."""
    log_evidence, left = exact(drive)
    assert 0.1 < left < 0.9, "both halves are possible, else there is nothing to compare"
    evidences, shares = found(drive, RULES, BLUNT)
    assert_is_mean_of(log_evidence, evidences, GRID_ERROR)
    assert_is_mean_of(left, shares, GRID_ERROR)


def test_a_repeated_search_uses_all_scans_moved_by_odometry(drive: Drive) -> None:
    """So blunt that one scan leaves more possible than is kept: four scans are joined."""
    bluntest = replace(BLUNT, scan_likelihood_exponent=0.05)
    log_evidence, left = exact_joined(drive, bluntest.scan_likelihood_exponent)
    evidences, shares = found(drive, replace(RULES, poses=4_000), bluntest)
    assert_is_mean_of(log_evidence, evidences, GRID_ERROR)
    assert_is_mean_of(left, shares, GRID_ERROR)
