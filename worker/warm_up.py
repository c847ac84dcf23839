"""Compiles the kernels, or reads them from their disk cache, before workers are forked."""

import logging

import numpy as np

from particle_filter import kernels
from particle_filter.arrays import OCCUPIED
from particle_filter.grid import Grid
from particle_filter.sensor_models import computed_model
from particle_filter.settings import FilterSettings, SearchSettings, SensorSettings
from protocol.arrays import ArrayBlob
from protocol.steps import Scan
from protocol.work import Assignment, ElsewhereJob, Particles, SearchJob, SearchReport, TrackJob
from worker.jobs import running

_log = logging.getLogger(__name__)


def compile_kernels(sensor: SensorSettings) -> None:
    """Run every kernel once: search a small map, track the places found, weigh elsewhere."""
    rng = np.random.default_rng(0)
    search = SearchSettings(heading_step_rad=0.2, poses=200, shards=1)
    small = FilterSettings(sensor=sensor, search=search)
    cells = np.zeros((40, 40), np.int8)
    cells[[0, -1], :] = cells[:, [0, -1]] = OCCUPIED
    model = computed_model(Grid(cells, 0.1, np.zeros(3)), sensor)
    job = running(
        Assignment(job_id="s", epoch=0, job=SearchJob(search=0, shard=0, first_step=0)),
        model,
        small,
        sender="warm-up",
    )
    for step in range(3):
        report = job.advance(_scan(step, rng))
    assert isinstance(report, SearchReport)  # the job is a search
    found = report.places.particles.array()
    sample = Particles(
        step=2,
        odom_from_robot=report.places.odom_from_robot,
        map_from_robot=report.places.particles,
        log_weights=ArrayBlob.of(np.zeros(len(found)), "float32"),
    )
    track = TrackJob(cluster=0, start=sample, exact=False)
    for one in (track, ElsewhereJob(first_step=3)):
        job = running(Assignment(job_id="c", epoch=0, job=one), model, small, sender="warm-up")
        job.advance(_scan(3, rng))
    if kernels.cache_problems:
        _log.warning(
            "compiled kernels cannot be kept on disk: %s; every start compiles for some "
            "seconds, unless NUMBA_CACHE_DIR names a folder that can be written",
            kernels.cache_problems[0],
        )


def _scan(step: int, rng: np.random.Generator) -> Scan:
    return Scan(
        sender="warm-up",
        step=step,
        stamp_ns=step,
        odom_from_robot=(0.3 * step, 0.0, 0.1 * step),
        robot_from_laser=(0.0, 0.0, 0.0),
        angle_min_rad=-1.5,
        angle_step_rad=0.05,
        range_max_m=10.0,
        ranges=ArrayBlob.of(rng.uniform(1.0, 2.0, 60), "float32"),
        map_digest="",
    )
