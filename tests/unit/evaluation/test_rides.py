"""A robot takes lifts in a building of three floors, of which two look alike."""

from collections.abc import Iterator

import numpy as np
import pytest

from clustermcl.belief.cluster_set import Candidate, ClusterSet
from clustermcl.belief.given_places import candidate, diagonal
from clustermcl.belief.links import is_in_cabin, ride
from clustermcl.evaluation.run import Case, EstimatedStep, Run, SimulatedRobot
from clustermcl.filter.random_streams import Purpose
from clustermcl.filter.settings import BeliefSettings, FilterSettings
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import Scan
from clustermcl.runtime.settings import Settings
from clustermcl.simulator.worlds.tower import tower

FLOORS = tower().map.floors
IN_LIFT, IN_CORRIDOR = (0.1, 2.3, 1.0), (5.0, 0.0, 0.0)


def on(floor: str, pose: PoseTuple = IN_LIFT) -> PoseTuple:
    return FLOORS.in_atlas(floor, pose)


def held_at(*poses: PoseTuple) -> ClusterSet:
    held, candidates = ClusterSet(), list[Candidate]()
    for pose in poses:
        place = candidate(
            0.5, pose, diagonal(0.1, 0.1), seed=0, purpose=Purpose.GIVEN_POSE, entity=0, step=0,
            odom_from_robot=(0.0, 0.0, 0.0),
        )  # fmt: skip
        candidates.append((place, "restart"))
    held.log_elsewhere = held.log_off_map = -np.inf
    held.admit(candidates, 0)
    return held


def scan(*ranges_m: float, beams: int = 40) -> Scan:
    return Scan(
        sender="test", step=1, stamp_ns=1, odom_from_robot=(0.0, 0.0, 0.0),
        robot_from_laser=(0.0, 0.0, 0.0), angle_min_rad=-1.0, angle_step_rad=0.05, range_max_m=12.0,
        ranges=ArrayBlob.of(np.resize(ranges_m, beams), "float32"), map_digest="", floors=FLOORS,
    )  # fmt: skip


@pytest.mark.parametrize(("ranges_m", "pose", "closed"), [
    ((1.0, 1.4, 0.6), IN_LIFT, True),
    ((1.0, 1.4, 0.6), IN_CORRIDOR, False),
    ((1.0, 1.4, 0.6, 5.0), IN_LIFT, False),  # the door is open
    ((1.0, np.inf, np.inf), IN_LIFT, False),
    ((1.0, 1.4, 2.3), IN_LIFT, True),
    ((1.0, 1.4, 2.9), IN_LIFT, False),
])  # fmt: skip
def test_a_closed_cabin_is_seen_where_there_is_one(
    ranges_m: tuple[float, ...], pose: PoseTuple, closed: bool
) -> None:
    assert is_in_cabin(scan(*ranges_m), held_at(on("first", pose))) == closed


def test_the_other_ends_get_the_hazard_and_probability_is_kept() -> None:
    held = held_at(on("ground"), on("first"), on("second", IN_CORRIDOR))
    held.settings = FilterSettings(belief=BeliefSettings(link_probability=0.2))
    ends = [place for place, _ in ride(held, scan(1.0), 0.5, in_cabin=False)]
    assert [(FLOORS.on_floor(end.pose)[0], end.share) for end in ends] == [
        ("second", pytest.approx(1 / 60)), ("second", pytest.approx(1 / 60))
    ]  # fmt: skip
    left = [1 / 3 - 1 / 60, 1 / 3 - 1 / 60, 1 / 3]
    assert [each.probability for each in held.all()] == pytest.approx(left)
    assert FLOORS.on_floor(ends[0].pose)[1] == pytest.approx(IN_LIFT)


def test_behind_closed_doors_all_floors_are_equally_probable() -> None:
    held = held_at(on("ground"), on("first"), on("second"))
    held.move({0: 0.6, 1: -0.3, 2: -0.3})
    assert ride(held, scan(1.0), 1.0, in_cabin=True) == []
    assert [each.probability for each in held.all()] == pytest.approx([1 / 3] * 3)


def test_links_that_name_unknown_floors_lead_nowhere() -> None:
    (link,) = FLOORS.links
    at = {**link.at, "attic": (0.0, 0.0)}
    hostile = type(FLOORS)(FLOORS.floors, (type(link)(link.name, at, link.radius_m),))
    assert len(hostile.rides(on("ground"))) == 2


def rides(seed: int, steps: int) -> Iterator[tuple[EstimatedStep, str, bool]]:
    """Yield the steps with the robot's floor, and whether the doors are closed."""
    case = Case(robot=SimulatedRobot(world="tower"), updates=steps)
    course, made = Run(case=case, seed=seed, settings=Settings()).begun()
    assert course.simulation is not None
    lift = course.simulation.lift
    assert lift is not None
    for step in made:
        assert step[2] is not None
        yield step, FLOORS.on_floor(step[2])[0], lift.middle is not None


def test_a_ride_is_followed_and_never_lost() -> None:
    found, closed, rode = list(rides(1, 260)), 0, []
    for (_, outcome, _), floor, in_cabin in found:
        assert outcome.state not in ("lost", "searching")
        best = FLOORS.place(outcome.hypotheses[0])
        if outcome.state == "localized":
            assert best.floor == floor
        closed += in_cabin
        if in_cabin:
            assert outcome.state == "ambiguous"
            assert max(h.probability for h in outcome.hypotheses) < 0.4
        elif not rode or rode[-1] != floor:
            rode.append(floor)
    assert rode == ["ground", "second", "ground"]
    assert closed > 20
    assert found[-1][0][1].state == "localized"
