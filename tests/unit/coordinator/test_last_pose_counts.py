"""Of whose robot the last pose counts: the bridge says with each scan whether the robot is live."""

import pytest

from coordinator.coordinator import Coordinator
from coordinator.events import ScanArrived, WorkerJoined
from coordinator.pose.last_pose import LastPose
from particle_filter.settings import FilterSettings, SearchSettings
from process_runtime.settings import CoordinatorSettings
from tests.unit.coordinator.reports import NO_SPREAD, literal_bayes, scan, searched
from tests.unit.coordinator.test_coordinator import NORTH, SOUTH, Story

EAST = (10.0, 5.0, 0.0)
POSE = LastPose(
    map_digest="map",
    stamp_ns=7,
    odom_from_robot=(0.0, 0.0, 0.0),
    map_from_robot=EAST,
    covariance=NO_SPREAD,
    probability=0.97,
)
of_whom = pytest.mark.parametrize(
    ("live", "state_folder", "counts"),
    [
        pytest.param(True, "", True, id="a live robot"),
        pytest.param(False, "", False, id="a recording, or a bridge that does not say"),
        pytest.param(False, "kept", True, id="a recording whose place a person wants kept"),
    ],
)


def story_of(state_folder: str) -> Story:
    story = Story()
    story.coordinator = Coordinator(
        "coordinator",
        FilterSettings(search=SearchSettings(shards=1), belief=literal_bayes()),
        CoordinatorSettings(state_folder=state_folder),
        "test",
        0,
        last_poses={"map": POSE},
    )
    story.follow(story.coordinator.handle(WorkerJoined("a"), 0))
    return story


@of_whom
def test_where_it_was_in_an_earlier_life_is_possible(
    live: bool, state_folder: str, counts: bool
) -> None:
    story = story_of(state_folder)
    story.follow(story.coordinator.handle(ScanArrived(scan(0, live=live)), 0))
    found = searched("s0.0", 0, {NORTH: 0.5, SOUTH: 0.5}, epoch=story.epochs["s0.0"])
    story.report(found, at_s=0.1)
    places = {place.mean for place in story.beliefs[-1].hypotheses}
    assert places == ({NORTH, SOUTH, EAST} if counts else {NORTH, SOUTH})


@of_whom
def test_where_it_is_will_be_of_use_to_the_next_life(
    live: bool, state_folder: str, counts: bool
) -> None:
    coordinator = story_of(state_folder).coordinator
    assert coordinator.pose_outlives_us == bool(state_folder), "before the first scan"
    coordinator.handle(ScanArrived(scan(0, live=live)), 0)
    assert coordinator.pose_outlives_us == counts
