import math

import pytest

from clustermcl.coordinator.checkpoint import state_in
from clustermcl.coordinator.events import WorkerChanged
from clustermcl.coordinator.recovery import LastPlace
from clustermcl.runtime.settings import CoordinatorSettings
from tests.unit.coordinator.reports import scan
from tests.unit.coordinator.test_coordinator import BOTH, Story, checkpoint_at

EAST = (10.0, 5.0, math.pi / 2)


@pytest.mark.parametrize(
    ("was_live", "live", "state_folder", "digest", "counts"),
    [
        pytest.param(True, True, "", "map", True, id="a live robot"),
        pytest.param(True, False, "", "map", False, id="a recording after it"),
        pytest.param(False, True, "", "map", False, id="after a recording"),
        pytest.param(False, False, "kept", "map", True, id="a recording in a folder of its own"),
        pytest.param(True, True, "", "another", False, id="in another map"),
    ],
)
def test_the_last_pose_is_a_hypothesis_only_for_the_same_robot_and_map(
    was_live: bool, live: bool, state_folder: str, digest: str, counts: bool
) -> None:
    rules = CoordinatorSettings(state_folder=state_folder)
    story = Story(rules=rules, kept=checkpoint_at(EAST, live=was_live))
    story.handle(WorkerChanged("a", "joined"))
    story.scan(0, live=live, digest=digest)
    story.finds(BOTH)
    places = {place.pose for place in story.beliefs[-1].hypotheses}
    assert places == (BOTH.keys() | {EAST} if counts else BOTH.keys())


def test_odometry_since_the_last_run_moves_the_last_pose_unless_it_was_reset() -> None:
    last = LastPlace.of(state_in(checkpoint_at(EAST, x_m=3.0)))
    assert last.as_prior_at(scan(0, x_m=0.1), 0.1, 0).pose == pytest.approx(EAST)
    prior = last.as_prior_at(scan(9, x_m=4.0), 0.1, 0)
    assert prior.pose == pytest.approx((10.0, 6.0, math.pi / 2))
    assert prior.sample.odom_from_robot == (4.0, 0.0, 0.0)
    assert prior.covariance[0] > last.covariance[0]
