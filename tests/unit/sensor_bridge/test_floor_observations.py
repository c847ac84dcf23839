from pathlib import Path

import numpy as np
import pytest

from clustermcl.filter.observations.kind import Landmarks
from clustermcl.filter.observations.likelihood import log_likelihood_ratio
from clustermcl.jobs.wire_observations import from_wire
from clustermcl.protocol.causes import Cause
from clustermcl.protocol.errors import LandmarksFileError
from clustermcl.protocol.floors import Floors
from clustermcl.protocol.steps import Observation
from clustermcl.recordings.maps.landmarks import load_landmarks
from clustermcl.runtime.settings import BridgeSettings
from clustermcl.sensor_bridge.floor_observations import in_atlas
from clustermcl.sensor_bridge.step_maker import StepMaker
from clustermcl.simulator.worlds.tower import tower

TOWER = tower().map
FLOORS = TOWER.floors


def observation(**changed: object) -> Observation:
    said = {"mean": (1.0, 2.0, 0.5), "covariance": tuple(np.eye(3).ravel()), **changed}
    return Observation(sender="gnss", stamp_ns=0, **said)


def barometer(**floors: float) -> Observation:
    said = {"mean": (0.0, 0.0), "covariance": tuple(np.eye(2).ravel())}
    return observation(**said, floors=floors)


def test_a_pose_on_a_floor_is_in_the_atlas() -> None:
    placed = in_atlas(observation(floor="first"), FLOORS)
    assert placed.mean == FLOORS.in_atlas("first", (1.0, 2.0, 0.5))


@pytest.mark.parametrize(("seen", "says"), [
    (observation(), "name a floor"),
    (observation(floor="attic"), "no floor 'attic'"),
    (barometer(ground=0.9, attic=0.1), "no floor 'attic'"),
])  # fmt: skip
def test_an_observation_of_an_unknown_floor_is_counted(seen: Observation, says: str) -> None:
    maker = StepMaker(BridgeSettings(), "", "test", floors=FLOORS)
    maker.observe(seen)
    assert maker.dropped == {Cause.UNKNOWN_FLOOR: 1}
    assert says in maker.dropped.details[Cause.UNKNOWN_FLOOR]


def test_one_map_has_no_floor_to_observe() -> None:
    plain = observation()
    assert in_atlas(plain, Floors()) is plain
    with pytest.raises(ValueError, match="the floors are: none"):
        in_atlas(barometer(ground=1.0), Floors())


def test_a_barometer_weighs_poses_by_their_floor() -> None:
    """Poses anywhere on a floor have its likelihood, relative to the average over free space."""
    said = {"ground": 0.7, "first": 0.2, "second": 0.1}
    seen = from_wire(in_atlas(barometer(**said), FLOORS))
    corners = [(x, y) for floor in FLOORS.floors for x in (floor.low[0] + 0.1, floor.high[0] - 0.1)
               for y in (floor.low[1] + 0.1, floor.high[1] - 0.1)]  # fmt: skip
    poses = np.array([(x, y, 0.0) for x, y in corners])
    logs = log_likelihood_ratio(poses, [seen], Landmarks.of([]), TOWER.grid).reshape(3, 4)
    assert np.ptp(logs, axis=1) == pytest.approx(0.0, abs=1e-5)
    right = np.exp(logs[:, 0]) - 0.05  # without the share of outliers
    assert right / right.sum() == pytest.approx(list(said.values()), abs=0.01)


def test_landmarks_of_a_building_name_their_floor(tmp_path: Path) -> None:
    file = tmp_path / "landmarks.yaml"
    file.write_text("landmarks: [{id: a, x: 1, y: 2, floor: first}]")
    (mark,) = load_landmarks(file, FLOORS)
    assert (mark.x, mark.y) == FLOORS.in_atlas("first", (1.0, 2.0, 0.0))[:2]
    with pytest.raises(LandmarksFileError, match="landmark 1: there is no floor 'first'"):
        load_landmarks(file)
    file.write_text("landmarks: [{id: a, x: 1, y: 2}]")
    with pytest.raises(LandmarksFileError, match="landmark 1: name a floor"):
        load_landmarks(file, FLOORS)
