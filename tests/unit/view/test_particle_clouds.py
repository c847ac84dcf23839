import numpy as np
import pytest

from clustermcl.protocol.work import Particles
from clustermcl.view.frames import MAX_PARTICLES, cloud_frame
from tests.unit.coordinator.reports import particles
from tests.unit.view.messages import report


def cloud(poses: np.ndarray, log_weights: np.ndarray) -> Particles:
    return particles(poses, log_weights, step=5, odom=(1.0, 2.0, 0.5))


def test_particles_are_given_in_centimetres_and_milliradians() -> None:
    frame = cloud_frame(3, cloud(np.array([[1.234, -5.678, 0.1234]]), np.zeros(1)))
    assert frame == {
        "cluster": 3, "step": 5, "odom": (1.0, 2.0, 0.5), "points": [123, -568, 123],
    }  # fmt: skip


def test_particles_are_drawn_in_proportion_to_their_weight() -> None:
    poses = np.zeros((3000, 3))
    poses[1000:, 0] = 1.0
    log_weights = np.where(poses[:, 0] > 0, np.log(0.25 / 2000), np.log(0.75 / 1000))
    points = cloud_frame(1, cloud(poses, log_weights))["points"]
    assert len(points) == 3 * MAX_PARTICLES
    assert np.mean(np.array(points[::3]) == 100) == pytest.approx(0.25, abs=0.01)


def test_particles_without_weight_are_not_drawn() -> None:
    poses = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    points = cloud_frame(1, cloud(poses, np.array([-np.inf, 0.0])))["points"]
    assert set(points[::3]) == {100}


def test_only_names_of_tracking_jobs_have_a_cluster_number() -> None:
    assert report(1, 12).cluster == 12
    for name in ("s3.1", "c", "c-1", "cx", "c" + "9" * 30):
        assert report(1, 12, job=name).cluster is None
