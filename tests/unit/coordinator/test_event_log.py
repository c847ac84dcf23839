from coordinator.state import KEPT_EVENTS, EventLog
from protocol.job_events import Ended


def test_the_last_events_are_kept_and_their_numbers_go_on() -> None:
    log = EventLog()
    for step in range(KEPT_EVENTS + 5):
        log.add([Ended(f"c{step}", "merged", ("c0",), 0.1)], step, step * 10)
    kept = tuple(log.kept)
    assert [event.number for event in kept] == list(range(5, KEPT_EVENTS + 5))
    assert (kept[0].event.job_id, kept[0].step, kept[0].stamp_ns) == ("c5", 5, 50)


def test_an_event_is_published_once() -> None:
    log = EventLog()
    log.add([Ended("s0.0", "search over"), Ended("s0.1", "search over")], 3, 30)
    assert [event.event.job_id for event in log.news()] == ["s0.0", "s0.1"]
    assert log.news() == ()
    assert len(tuple(log.kept)) == 2
