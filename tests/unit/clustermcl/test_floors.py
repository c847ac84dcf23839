"""A building of two floors: the poses of beliefs, commands and observations are on its floors."""

from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import pytest

from clustermcl import Belief, ClusterMCL, CommandRefusedError, GridMap, load_map
from clustermcl.simulator.simulation import Simulation, Tick
from clustermcl.simulator.worlds.catalogue import world
from tests.integration.system.conftest import SMALL
from tests.maps import write_map
from tests.unit.clustermcl import tags

CROSS, HALL = world("cross_feature"), world("hall")


@pytest.fixture
def building(tmp_path: Path) -> GridMap:
    write_map(CROSS.map, tmp_path, "cross")
    write_map(HALL.map, tmp_path, "hall")
    (tmp_path / "building.yaml").write_text("floors: {ground: cross.yaml, third: hall.yaml}\n")
    return load_map(tmp_path / "building.yaml")


def robot() -> Simulation:
    return Simulation(HALL, 3)


def driven(
    mcl: ClusterMCL, robot: Iterator[Tick], ticks: int
) -> tuple[Belief, tuple[float, float, float]]:
    """Return the last belief while a robot drives in the hall, and its true pose there."""
    *_, (belief, tick) = tags.driven(mcl, islice(robot, ticks))
    return belief, tick.map_from_robot


def test_the_belief_names_the_floor_and_the_pose_there(building: GridMap) -> None:
    belief, truth = driven(ClusterMCL(building, settings=SMALL), robot(), 300)
    assert (belief.state, belief.floor) == ("localized", "third")
    assert belief.pose == pytest.approx(truth, abs=0.3)
    assert belief.floors.keys() == {"ground", "third"}
    assert belief.floors["third"] == pytest.approx(
        sum(place.probability for place in belief.hypotheses if place.floor == "third")
    )
    assert "on floor third" in repr(belief)


def test_one_map_has_no_floors() -> None:
    mcl = ClusterMCL(HALL.map, settings=SMALL)
    belief, _ = driven(mcl, robot(), 30)
    assert (belief.floor, belief.floors) == ("", {})
    with pytest.raises(CommandRefusedError, match="no floor 'third'; the floors are: none"):
        mcl.set_pose((0.0, 0.0, 0.0), floor="third")


def test_a_pose_is_given_on_a_floor(building: GridMap) -> None:
    mcl = ClusterMCL(building, settings=SMALL)
    driven(mcl, robot(), 30)
    with pytest.raises(CommandRefusedError, match="name a floor; the floors are: ground, third"):
        mcl.set_pose((1.0, 0.5, 0.1))
    with pytest.raises(CommandRefusedError, match="no floor 'attic'"):
        mcl.set_pose((1.0, 0.5, 0.1), floor="attic")
    beside_m = building.floors.floor("third").shift[0] - building.floors.floor("ground").shift[0]
    for x, floor in ((30.0, "third"), (1.0 + beside_m, "ground")):
        with pytest.raises(CommandRefusedError, match=rf"no free ground .* of x {x:.2f} m, y 0.50"):
            mcl.set_pose((x, 0.5, 0.1), floor=floor)
    mcl.set_pose((1.0, 0.5, 0.1), floor="third")
    assert mcl.belief is not None
    assert mcl.belief.floor == "third"
    assert mcl.belief.pose == pytest.approx((1.0, 0.5, 0.1), abs=0.5)


def test_a_search_can_be_on_one_floor(building: GridMap) -> None:
    mcl, drives = ClusterMCL(building, settings=SMALL), robot()
    driven(mcl, drives, 100)
    for near, floor, says in (
        ((1.0, 1.0, 2.0), "", "name a floor"),
        (None, "attic", "no floor 'attic'"),
    ):
        with pytest.raises(CommandRefusedError, match=says):
            mcl.relocalize(near, floor=floor)
    mcl.relocalize((0.0, 0.0, 200.0), floor="ground")
    belief, _ = driven(mcl, drives, 60)
    assert {place.floor for place in belief.hypotheses} <= {"ground"}
