from process_runtime.settings import Settings
from protocol import keys
from protocol.codec import encode
from protocol.job_events import Ended, JobEvents, NumberedEvent
from protocol.message import Message
from soak_test.listener import Heard
from soak_test.robot import TRUTH_KEY, TrueMotion
from soak_test.robot_checks import Promised, RobotChecks
from soak_test.rooms import PLACES, copies_in_all_rooms, eight_rooms
from tests.unit.soak_test.hear import at, belief, place

ROOMS_PROMISE = "all 8 true places are held"


def test_eight_clusters_are_not_eight_rooms() -> None:
    """What is heard of a restart that puts a wrong place in for a true one."""
    checks = RobotChecks(Settings(), Promised(rooms=True, delay_s=None, chaos=False))
    truth = eight_rooms().start
    assert truth is not None

    def hear(second: float, key: str, message: Message) -> None:
        checks.on_arrived(Heard(at(second), key, encode(message)))

    true = [place(n, 1 / PLACES, copy) for n, copy in enumerate(copies_in_all_rooms(truth))]
    wrong = place(8, 1 / PLACES, (0.0, 0.0, 2.0))
    for step, places in enumerate(([*true[1:], wrong], true, [*true[:7], wrong], true), start=1):
        hear(step, TRUTH_KEY, TrueMotion(sender="r", stamp_ns=at(step), map_from_robot=truth))
        if step == 3:
            event = Ended("c7", "pushed out", ("c8",), 0.1)
            numbered = NumberedEvent(number=0, step=step, stamp_ns=at(step), event=event)
            hear(step, keys.EVENTS, JobEvents(sender="coordinator", events=(numbered,)))
        hear(step + 0.01, keys.BELIEF, belief(step, *places, stamp_s=step))
        assert checks.ready is (step > 1)
        checks.judging = checks.ready
    verdict = next(v for v in checks.verdicts(at(5)) if v.promise == ROOMS_PROMISE)
    assert verdict.kept is False
    assert [broken.what for broken in verdict.breaks] == [
        "room 7 at step 3 for 1.0 s (1 beliefs): c7 was pushed out by c8 (0.1); then held by c7"
    ]
