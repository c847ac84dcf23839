from collections.abc import Sequence

import pytest
from msgspec.structs import replace

from clustermcl.protocol.answers import Hypothesis
from clustermcl.protocol.message import PoseTuple
from tests.soak import promises
from tests.soak.eight_rooms import PLACES, copies_in_all_rooms, eight_rooms
from tests.soak.schedule import DoneFault, Kind
from tests.unit.view import messages

SECOND = 1_000_000_000
START = eight_rooms().start
assert START is not None
COPIES = copies_in_all_rooms(START)
HERE, FAR = (1.0, 2.0, 0.5), (9.0, 2.0, 0.5)


def at(seconds: float) -> int:
    """That long after the start [ns]."""
    return 1_700_000_000 * SECOND + round(seconds * SECOND)


def outages(*faults: tuple[Kind, float, float]) -> promises.Outages:
    known = promises.Outages()
    known.faults += [DoneFault(kind, at(begin), at(end), "bridge") for kind, begin, end in faults]
    return known


@pytest.mark.parametrize("unanswered", [2, 3])
def test_two_queries_in_two_thousand_may_go_unanswered(unanswered: int) -> None:
    promise = promises.Answered(outages())
    for number in range(2000):
        answer = None if number < unanswered else messages.pose(1)
        promise.on_question(promises.Question(at(number), at(number), answer))
    assert promise.verdict().kept is (unanswered == 2)


@pytest.mark.parametrize(("steps", "delay_s", "kind", "broken"), [
    ((4, 5, 6), 0.5, None, []),
    ((1, 2, 2), 0.5, None, ["step 2 again"]),
    ((1, 2, 5), 0.5, None, ["2 steps before step 5 are lost"]),
    ((1, 2, 5), 0.5, Kind.ROUTER_KILLED, []),
    ((1,), 2.5, None, ["step 1 took 2.50 s"]),
])  # fmt: skip
def test_each_step_is_decided_once_and_in_time(
    steps: Sequence[int], delay_s: float, kind: Kind | None, broken: list[str]
) -> None:
    promise = promises.StepsOnce(outages(*([(kind, 11.5, 11.5)] if kind else [])), longest_s=2.0)
    for second, step in enumerate(steps, 10):
        promise.on_scan(at(second), step)
        promise.on_belief(at(second + delay_s), step)
    assert [one.what for one in promise.verdict().breaks] == broken


def place(cluster: int, probability: float, mean: PoseTuple) -> Hypothesis:
    return replace(messages.hypothesis(cluster, probability), pose=mean)


def rooms(**instead: PoseTuple) -> list[Hypothesis]:
    """A cluster in each room, c0 in room 0 and so on, but for some that are elsewhere."""
    means = [instead.get(f"c{room}", copy) for room, copy in enumerate(COPIES)]
    return [place(cluster, 1.0 / PLACES, mean) for cluster, mean in enumerate(means)]


class Robot:
    """One belief a second, with its true pose."""

    def __init__(self, truth: PoseTuple) -> None:
        places_of = copies_in_all_rooms if truth == START else lambda pose: (pose,)
        self.promise = promises.TruthHeld(outages(), places_of)
        self.truth = truth

    def believes(
        self, second: float, *places: Hypothesis, missing: tuple[str, ...] = (), kidnapped: int = 0
    ) -> "Robot":
        self.promise.on_truth(at(second), self.truth, kidnapped)
        what = replace(messages.belief(int(second)), stamp_ns=at(second), hypotheses=places)
        self.promise.on_belief(at(second), replace(what, missing=missing))
        return self

    def broken(self, now_s: float = 1000.0) -> Sequence[str]:
        return [each.what for each in self.promise.verdict(at(now_s)).breaks]


@pytest.mark.parametrize(("held", "lost"), [
    (rooms(c2=(COPIES[2][0] + 0.9, COPIES[2][1], COPIES[2][2] + 0.3)), []),
    (rooms(c2=(COPIES[2][0] + 1.1, *COPIES[2][1:])), [2]),
    (rooms(c2=(*COPIES[2][:2], COPIES[2][2] + 0.4)), [2]),
    (rooms(c7=COPIES[0]), [7]),
    ([place(-1 - n, 1 / PLACES, copy) for n, copy in enumerate(COPIES)], [*range(PLACES)]),
])  # fmt: skip
def test_each_room_is_tracked_within_a_metre_and_twenty_degrees_after_the_first_complete_belief(
    held: list[Hypothesis], lost: list[int]
) -> None:
    robot = Robot(START).believes(1, *rooms()[1:])  # type: ignore[arg-type] # it is there
    assert not robot.promise.is_complete
    robot.believes(2, *rooms()).believes(3, *held).believes(4, *held)
    assert robot.broken() == [f"step 3: place {room} is lost" for room in lost]


def test_a_sure_belief_in_a_wrong_place_is_noticed_unless_no_worker_reported() -> None:
    robot = Robot(HERE).believes(1, place(1, 1.0, HERE))
    wrong = place(0, 0.95, FAR), place(1, 0.05, HERE)
    assert robot.believes(2, *wrong, missing=("c0", "c1")).broken() == []
    assert robot.believes(3, *wrong, missing=("c0",)).broken() == ["step 3: sure and 8.0 m off"]


def test_a_kidnapped_robot_has_to_be_found_in_time_and_held_then() -> None:
    for late_s, kept in ((-0.5, True), (0.5, False)):
        robot = Robot(HERE).believes(1, place(0, 1.0, HERE))
        robot.believes(2, place(0, 1.0, FAR), kidnapped=1)
        assert robot.promise.verdict(at(10)).kept is True, "there is still time"
        robot.believes(2 + promises.FOUND_WITHIN_S + late_s, place(0, 1.0, HERE), kidnapped=1)
        assert robot.promise.verdict(at(600.0)).kept is kept
    robot.believes(100, place(1, 0.5, FAR), place(2, 0.5, FAR), kidnapped=1)
    assert len(robot.broken()) == 2, "lost again is lost"
