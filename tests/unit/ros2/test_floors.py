"""What ROS sees of a building: the floor, the pose on it, and the map that nav2 is to load."""

from pathlib import Path

import pytest
from msgspec.structs import replace

from clustermcl.protocol.answers import Belief, SetPose, State
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import Observation
from clustermcl.ros2 import topics
from clustermcl.ros2.floor_maps import TIMEOUT_NS, FloorMaps
from clustermcl.ros2.messages_out import pose_stamped
from clustermcl.ros2.port import Port
from clustermcl.ros2.pose_choice import PoseChoice
from clustermcl.runtime.settings import BridgeSettings, Ros2Settings, Settings
from tests.unit.maps.test_building import write_building
from tests.unit.ros2.ports import COVARIANCE, Kept, belief
from tests.unit.ros2.test_amcl import SECOND, grid
from tests.unit.ros2.test_port import active

AT: PoseTuple = (5.0, -3.0, 0.5)
FILES = {"ground": Path("g.yaml"), "third": Path("t.yaml")}


def on(*floors: tuple[str, float], state: State = "localized", stamp_ns: int = SECOND) -> Belief:
    """A belief with a place at the same pose on each floor, most probable first."""
    plain = belief(stamp_ns, *((n, p, AT) for n, (_, p) in enumerate(floors)), state=state)
    placed = tuple(
        replace(place, floor=floor)
        for place, (floor, _) in zip(plain.hypotheses, floors, strict=True)
    )
    return replace(plain, hypotheses=placed, floors=dict(floors))


@pytest.fixture
def building(tmp_path: Path) -> Settings:
    file = write_building(tmp_path)
    ros2 = Ros2Settings(load_floor_maps=True, initial_floor="ground", pose_topics="uwb")
    return Settings(bridge=BridgeSettings(map=str(file)), ros2=ros2)


def said(tested: Port, kept: Kept) -> dict[str, str]:
    kept.process_ns += SECOND
    tested.tick()
    (status,) = kept.on(topics.DIAGNOSTICS)[-1].status
    return {one.key: one.value for one in status.values}


def test_a_floor_is_told_and_its_map_loaded_once_it_is_sure(
    building: Settings, tmp_path: Path
) -> None:
    tested, kept = active(building)
    tested.on_belief(on(("third", 0.6), ("ground", 0.4), state="ambiguous"))
    assert kept.loads == []
    tested.on_belief(on(("third", 0.97), ("ground", 0.03)))
    tested.on_belief(on(("third", 0.98), ("ground", 0.02)))
    assert kept.loads == [str(tmp_path / "third.yaml")]
    assert [message.data for message in kept.on(topics.FLOOR)] == ["third"]
    assert tested.waits_for_map
    assert said(tested, kept)["map of floor"] == "none yet"
    tested.on_map_loaded("")
    assert not tested.waits_for_map
    values = said(tested, kept)
    assert (values["map of floor"], values["floor third"]) == ("third", "0.980")
    tested.on_belief(on(("ground", 0.99), ("third", 0.01)))
    assert kept.loads[1:] == [str(tmp_path / "ground.yaml")]


def test_map_server_that_does_not_answer_or_refuses_is_told_and_asked_again() -> None:
    maps, sure = FloorMaps(FILES), on(("third", 0.97))
    assert maps.on_belief(sure, 0) == FILES["third"]
    assert maps.waits(TIMEOUT_NS)
    assert not maps.waits(TIMEOUT_NS + 1)
    assert maps.problem == "floor third: load_map has not answered for 10 s"
    assert maps.on_belief(sure, TIMEOUT_NS) == FILES["third"]
    maps.on_answer("map_server refuses it")
    assert (maps.problem, maps.loaded) == ("floor third: map_server refuses it", "")


def test_maps_of_ros_do_not_replace_the_building(building: Settings) -> None:
    tested, kept = active(building)
    tested.on_message(topics.Topics(Ros2Settings()).map, grid())
    assert kept.readings == []


def test_given_and_observed_poses_are_on_the_published_floor(building: Settings) -> None:
    tested, kept = active(building)
    given = pose_stamped((1.0, 2.0, 0.5), COVARIANCE, 0, "map")
    tested.on_message(topics.INITIAL_POSE, given)
    tested.on_belief(on(("third", 0.97)))
    tested.on_message(topics.INITIAL_POSE, given)
    assert [c.floor for c in kept.commands if isinstance(c, SetPose)] == ["ground", "third"]
    kept.log.clear()
    names = topics.Topics(building.ros2)
    tested.on_message(names.observed[0], pose_stamped((1.0, 2.0, 0.5), COVARIANCE, SECOND, "map"))
    assert [one.floor for one in kept.readings if isinstance(one, Observation)] == ["third"]


def test_a_place_above_is_not_the_same_place() -> None:
    """A held cluster that ended is not continued on another floor, and adds no covariance."""
    choice = PoseChoice("held")
    choice.choose(on(("third", 0.97)), None)
    choice.held = 99
    there = on(("ground", 0.6), ("third", 0.4), state="ambiguous")
    chosen = choice.choose(there, AT)
    assert chosen is not None
    assert chosen.floor == "third"
    assert chosen.covariance == pytest.approx(COVARIANCE)
