from protocol.answers import Hypothesis
from protocol.job_events import Ended, JobEvents, NumberedEvent
from protocol.message import PoseTuple
from soak_test.end_causes import EndCauses
from soak_test.room_check import RoomsHeld
from soak_test.rooms import PLACES, copies_in_all_rooms, eight_rooms
from soak_test.true_poses import JudgedBelief
from tests.unit.soak_test.hear import at, belief, place

TRUTH = eight_rooms(room=3).start
assert TRUTH is not None
COPIES = copies_in_all_rooms(TRUTH)


def all_held(**instead: PoseTuple) -> list[Hypothesis]:
    """A cluster in each room, c0 in room 0 and so on, but for some that are elsewhere."""
    means = [instead.get(f"c{room}", copy) for room, copy in enumerate(COPIES)]
    return [place(cluster, 1.0 / PLACES, mean) for cluster, mean in enumerate(means)]


def heard(step: int, *places: Hypothesis, missing: tuple[str, ...] = ()) -> JudgedBelief:
    """One step a second."""
    assert TRUTH is not None
    return JudgedBelief(at(float(step)), belief(step, *places, missing=missing), TRUTH)


def moved(pose: PoseTuple, metres: float, turn_rad: float) -> PoseTuple:
    return pose[0] + metres, pose[1], pose[2] + turn_rad


def ended(causes: EndCauses, event: Ended) -> None:
    numbered = NumberedEvent(number=0, step=2, stamp_ns=at(2.0), event=event)
    causes.on_events(JobEvents(sender="coordinator", events=(numbered,)))


def told(check: RoomsHeld) -> list[str]:
    return [broken.what for broken in check.verdict().breaks]


def test_rooms_count_from_when_all_are_held() -> None:
    check = RoomsHeld(EndCauses())
    check.judge(heard(1, *all_held()[1:]))
    assert not check.complete
    assert check.verdict().kept is False
    check.judge(heard(2, *all_held()))
    assert check.complete
    assert check.verdict().kept is True


def test_a_wrong_place_in_for_a_true_one_is_a_lost_room_though_the_number_is_right() -> None:
    causes = EndCauses()
    check = RoomsHeld(causes)
    check.judge(heard(1, *all_held()))
    ended(causes, Ended("c6", "pushed out", ("c8",), 0.1))
    wrong = place(8, 0.01, moved(COPIES[5], 2.4, 1.57))
    eight = [*(each for each in all_held() if each.cluster != 6), wrong]
    assert len(eight) == PLACES
    check.judge(heard(2, *eight))
    check.judge(heard(3, *eight))
    check.judge(heard(4, *eight[:-1], place(9, 0.1, COPIES[6])))
    verdict = check.verdict()
    assert verdict.kept is False
    assert verdict.figures == {"short": 2, "beliefs": 4, "fewest": 7, "lost": 1, "longest_s": 2.0}
    assert [broken.at_ns for broken in verdict.breaks] == [at(2.0)]
    pushed_out = "c6 was pushed out by c8 (0.1)"
    assert told(check) == [f"room 6 at step 2 for 2.0 s (2 beliefs): {pushed_out}; then held by c9"]


def test_a_room_that_is_not_found_again_is_lost_to_the_end() -> None:
    check = RoomsHeld(EndCauses())
    check.judge(heard(1, *all_held()))
    for step in (2, 3, 4):
        check.judge(heard(step, *all_held()[1:]))
    assert told(check) == ["room 0 at step 2 for 2.0 s (3 beliefs): c0 has gone, nobody said why"]


def test_a_cluster_that_strays_does_not_hold_its_room() -> None:
    check = RoomsHeld(EndCauses())
    check.judge(heard(1, *all_held(c2=moved(COPIES[2], 0.9, 0.3))))
    assert check.complete  # within 1 m and 20 degrees
    check.judge(heard(2, *all_held(c2=moved(COPIES[2], 1.1, 0.0))))
    check.judge(heard(3, *all_held()))
    check.judge(heard(4, *all_held(c2=moved(COPIES[2], 0.0, 0.4))))
    assert told(check) == [
        "room 2 at step 2 for 1.0 s (1 beliefs): c2 has strayed 1.1 m and 0 degrees"
        "; then held by c2",
        "room 2 at step 4 for 0.0 s (1 beliefs): c2 has strayed 0.0 m and 23 degrees",
    ]


def test_two_clusters_in_one_room_hold_no_other() -> None:
    check = RoomsHeld(EndCauses())
    check.judge(heard(1, *all_held()))
    check.judge(heard(2, *all_held(c7=COPIES[0])))
    assert check.verdict().figures["fewest"] == PLACES - 1


def test_places_that_a_search_holds_possible_are_no_clusters() -> None:
    check = RoomsHeld(EndCauses())
    check.judge(heard(1, *all_held()))
    forgotten = [place(-1 - room, 1.0 / PLACES, copy) for room, copy in enumerate(COPIES)]
    check.judge(heard(2, *forgotten))
    check.judge(heard(3))
    assert check.verdict().figures["fewest"] == 0
    assert check.verdict().figures["short"] == 2


def test_a_belief_that_no_worker_has_reported_to_is_left_out() -> None:
    check = RoomsHeld(EndCauses())
    check.judge(heard(1, *all_held()))
    far = all_held(c1=moved(COPIES[1], 3.0, 0.0))
    check.judge(heard(2, *far, missing=tuple(f"c{each.cluster}" for each in far)))
    assert check.verdict().kept is True
    check.judge(heard(3, *far, missing=("c1",)))
    assert check.verdict().kept is False
