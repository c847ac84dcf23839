import math

import numpy as np
import pytest
from msgspec.structs import replace

from clustermcl.filter.cluster.cluster_filter import ParticleSet, measurement_update
from clustermcl.filter.grid import Grid
from clustermcl.filter.laser.sensor_model import SensorModel, computed_model
from clustermcl.filter.random_streams import Purpose, generator
from clustermcl.filter.search.uniform_poses import UniformPoses
from clustermcl.jobs.jobs import RunningJob, running
from clustermcl.jobs.scan_arrays import scan_beams
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.steps import Seen
from clustermcl.protocol.work import Assignment, ElsewhereJob
from tests.unit.oracle.tiny_world import CELL_M, SENSOR, TRUTH, Drive, plain_room, settings


@pytest.fixture(scope="module")
def model() -> SensorModel:
    return computed_model(Grid(plain_room(), CELL_M, np.zeros(3)), SENSOR)


@pytest.fixture(scope="module")
def drive() -> Drive:
    return Drive(plain_room(), TRUTH, 4)


def begun(model: SensorModel) -> RunningJob:
    job = Assignment(job_id="e0", epoch=3, job=ElsewhereJob(first_step=1))
    return running(job, model, settings(0, elsewhere_poses=2000), sender="w")


def test_the_likelihood_elsewhere_is_the_average_over_even_poses(
    model: SensorModel, drive: Drive
) -> None:
    """The same poses weighed as a cluster's particles are, one by one."""
    report = begun(model).advance(drive.scans[0])
    of_map = generator(0, purpose=Purpose.ELSEWHERE, entity=0, step=0, part=1)
    of_step = generator(0, purpose=Purpose.ELSEWHERE, entity=0, step=1)
    poses = UniformPoses(model.grid, of_map).draw(2000, of_step)
    beams = scan_beams(drive.scans[0], model)
    logs = np.array(
        [
            measurement_update(ParticleSet.even(pose[None]), beams, model).log_weight_sum
            for pose in poses
        ]
    )
    expected = np.logaddexp.reduce(logs) - np.log(2000.0)
    assert report.log_likelihood == pytest.approx(expected)


def test_places_that_an_observation_allows_are_found_with_the_scan(
    model: SensorModel, drive: Drive
) -> None:
    fix = Seen(
        landmark="", mean=(*TRUTH[:2].tolist(),), covariance=(4.0, 0.0, 0.0, 4.0),
        outlier_probability=0.05, share=1.0,
    )  # fmt: skip
    report = begun(model).advance(replace(drive.scans[0], observations=(fix,)))
    assert math.dist(report.places.mean.array()[0, :2], TRUTH[:2]) < 0.2


def test_a_scan_without_beams_has_the_same_likelihood_everywhere(
    model: SensorModel, drive: Drive
) -> None:
    nothing = ArrayBlob.of(np.full(12, np.nan), "float32")
    report = begun(model).advance(replace(drive.scans[0], ranges=nothing))
    assert report.log_likelihood == 0.0


def test_elsewhere_is_handed_on_to_the_step_after_its_last(
    model: SensorModel, drive: Drive
) -> None:
    job = begun(model)
    assert job.handed_on() == job.assignment
    job.advance(drive.scans[0])
    assert job.handed_on().job == ElsewhereJob(first_step=2)
