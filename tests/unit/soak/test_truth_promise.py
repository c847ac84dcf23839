from collections.abc import Sequence

import pytest

from protocol.answers import Hypothesis
from protocol.message import PoseTuple
from tests.soak.eight_rooms import PLACES, copies_in_all_rooms, eight_rooms
from tests.soak.promises import BACK_WITHIN_S, FOUND_WITHIN_S, Outages, TruthHeld
from tests.soak.schedule import Kind
from tests.unit.soak.made_up import at, belief, fault, outages, place

START = eight_rooms().start
assert START is not None
COPIES = copies_in_all_rooms(START)
HERE, FAR = (1.0, 2.0, 0.5), (9.0, 2.0, 0.5)


def all_held(**instead: PoseTuple) -> list[Hypothesis]:
    """A cluster in each room, c0 in room 0 and so on, but for some that are elsewhere."""
    means = [instead.get(f"c{room}", copy) for room, copy in enumerate(COPIES)]
    return [place(cluster, 1.0 / PLACES, mean) for cluster, mean in enumerate(means)]


def moved(pose: PoseTuple, metres: float, turn_rad: float) -> PoseTuple:
    return pose[0] + metres, pose[1], pose[2] + turn_rad


class Robot:
    """One belief a second, with its true pose."""

    def __init__(self, truth: PoseTuple, known: Outages | None = None) -> None:
        places_of = copies_in_all_rooms if truth == START else lambda pose: (pose,)
        self.promise = TruthHeld(known or outages(), places_of)
        self.truth = truth

    def believes(
        self, second: float, *places: Hypothesis, missing: tuple[str, ...] = (), kidnapped: int = 0
    ) -> None:
        self.promise.on_truth(at(second), self.truth, kidnapped)
        what = belief(int(second), *places, stamp_s=second, missing=missing)
        self.promise.on_belief(at(second), what)

    def broken(self, now_s: float = 1000.0) -> Sequence[str]:
        return [each.what for each in self.promise.verdict(at(now_s)).breaks]


def test_places_count_from_the_first_belief_that_holds_all() -> None:
    robot = Robot(START)
    robot.believes(1, *all_held()[1:])
    assert not robot.promise.is_complete
    robot.believes(2, *all_held())
    assert robot.promise.is_complete
    assert robot.promise.verdict(at(3)).kept is True
    assert robot.promise.verdict(at(3)).figures["beliefs"] == 1


def test_a_lost_place_is_reported_once() -> None:
    robot = Robot(START)
    robot.believes(1, *all_held())
    others = [each for each in all_held() if each.cluster != 6]
    wrong = place(8, 1 / PLACES, moved(COPIES[5], 2.4, 1.57))
    robot.believes(2, *others, wrong)
    robot.believes(3, *others, wrong)
    robot.believes(4, *others, place(9, 1 / PLACES, COPIES[6]))
    assert robot.broken() == ["step 2: place 6 is lost"]
    assert robot.promise.verdict(at(5)).figures["short"] == 2


@pytest.mark.parametrize(("metres", "turn_rad", "held"), [
    (0.9, 0.3, True), (1.1, 0.0, False), (0.0, 0.4, False),
])  # fmt: skip
def test_a_place_is_held_within_a_metre_and_twenty_degrees(
    metres: float, turn_rad: float, held: bool
) -> None:
    robot = Robot(START)
    robot.believes(1, *all_held())
    robot.believes(2, *all_held(c2=moved(COPIES[2], metres, turn_rad)))
    assert (not robot.broken()) is held


def test_another_rooms_cluster_and_places_of_a_search_do_not_hold_a_room() -> None:
    robot = Robot(START)
    robot.believes(1, *all_held())
    robot.believes(2, *all_held(c7=COPIES[0]))
    assert len(robot.broken()) == 1
    robot.believes(3, *(place(-1 - n, 1 / PLACES, copy) for n, copy in enumerate(COPIES)))
    assert len(robot.broken()) == PLACES


def test_a_sure_belief_in_a_wrong_place_is_noticed_though_the_true_one_is_held() -> None:
    robot = Robot(HERE)
    robot.believes(1, place(1, 1.0, HERE))
    robot.believes(2, place(0, 0.95, FAR), place(1, 0.05, HERE))
    assert robot.broken() == ["step 2: sure and 8.0 m off"]


def test_a_belief_to_which_no_worker_has_reported_is_left_out() -> None:
    robot = Robot(HERE)
    robot.believes(1, place(0, 0.5, HERE), place(1, 0.5, FAR))
    far = place(0, 0.5, FAR), place(1, 0.5, FAR)
    robot.believes(2, *far, missing=("c0", "c1"))
    assert robot.broken() == []
    robot.believes(3, *far, missing=("c0",))
    assert len(robot.broken()) == 1


def test_a_belief_that_arrives_before_its_true_pose_is_judged_later() -> None:
    robot = Robot(HERE)
    robot.promise.on_belief(at(1.1), belief(1, place(0, 1.0, HERE), stamp_s=1.0))
    assert robot.promise.verdict(at(2)).kept is False
    robot.promise.on_truth(at(1.0), HERE, 0)
    assert robot.promise.verdict(at(2)).kept is True


def test_a_kidnapped_robot_is_not_judged_until_it_is_found() -> None:
    robot = Robot(HERE)
    robot.believes(1, place(0, 1.0, HERE))
    robot.believes(2, place(0, 1.0, FAR), kidnapped=1)
    robot.believes(6.5, place(1, 1.0, HERE), kidnapped=1)
    verdict = robot.promise.verdict(at(600.0))
    assert verdict.kept is True
    assert verdict.figures["found"] == 1
    assert verdict.figures["found_longest_s"] == 4.5
    robot.believes(7, place(1, 0.5, FAR), place(2, 0.5, FAR), kidnapped=1)
    assert robot.promise.verdict(at(8)).kept is False, "lost again is lost"


@pytest.mark.parametrize(("known", "allowed_s"), [
    (outages(), FOUND_WITHIN_S),
    (outages(fault(Kind.COORDINATOR_KILLED, 20.0)), FOUND_WITHIN_S + BACK_WITHIN_S),
])  # fmt: skip
def test_a_kidnapped_robot_has_to_be_found_in_time(known: Outages, allowed_s: float) -> None:
    for late_s, kept in ((-0.5, True), (0.5, False)):
        robot = Robot(HERE, known)
        robot.believes(1, place(0, 1.0, HERE))
        robot.believes(2, place(0, 1.0, FAR), kidnapped=1)
        robot.believes(2 + allowed_s + late_s, place(0, 1.0, HERE), kidnapped=1)
        assert robot.promise.verdict(at(600.0)).kept is kept
    robot = Robot(HERE, known)
    robot.believes(1, place(0, 1.0, HERE))
    robot.believes(2, place(0, 1.0, FAR), kidnapped=1)
    assert robot.promise.verdict(at(10)).kept is True, "there is still time"
    assert len(robot.broken()) == 1, "it was never found"
