import numpy as np
import pytest

from benchmarks.experiments.baselines import VisibleFieldModel
from particle_filter.settings import SensorSettings
from tests.unit.particle_filter.rooms import model_of, plain_room, seen_from, symmetric_room

WITH_BOX, WITHOUT_BOX = symmetric_room(), plain_room()
HERE = np.array([3.0, 3.2, 0.0])
POSES = HERE + np.array([[0.0, 0.0, 0.0], [0.02, 0.0, 0.0], [0.0, -0.02, 0.01]])
THROUGH_THE_BOX = seen_from(HERE, WITHOUT_BOX)
"""A scan of the room without the second box: in the map with it, beams end behind it."""


def visible(most_poses: int = 10) -> VisibleFieldModel:
    settings = SensorSettings(
        occlusion_weight=0.3, occlusion_tolerance=0.05, visibility_beam_stride=1
    )
    field = model_of(WITH_BOX, settings)
    return VisibleFieldModel(
        field.grid, field.field, field.pyramid, field.jumps, field.settings, most_poses
    )


def test_each_pose_loses_a_share_of_what_it_was_given_beyond_what_is_tolerated() -> None:
    model, beams = visible(), THROUGH_THE_BOX
    field = model_of(WITH_BOX, model.settings)
    hidden = field.occluded(POSES, beams)
    assert (hidden > 0.05 * beams.count + 5.0).all()
    lost = field.log_likelihood(POSES, beams) - model.log_likelihood(POSES, beams)
    np.testing.assert_allclose(lost, 0.3 * (hidden - 0.05 * beams.count), atol=1e-9)


def test_where_nothing_is_hidden_it_is_the_field() -> None:
    seen = seen_from(HERE, WITH_BOX)
    field = model_of(WITH_BOX, visible().settings)
    assert visible().log_likelihood(POSES, seen) == pytest.approx(field.log_likelihood(POSES, seen))


def test_of_too_many_poses_only_the_field_is_asked() -> None:
    field = model_of(WITH_BOX, visible().settings)
    expected = field.log_likelihood(POSES, THROUGH_THE_BOX)
    assert visible(most_poses=2).log_likelihood(POSES, THROUGH_THE_BOX) == pytest.approx(expected)
    assert (visible(most_poses=3).log_likelihood(POSES, THROUGH_THE_BOX) < expected).all()
