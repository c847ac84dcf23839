from clustermcl.coordinator.event_log import HANDED_ON_EVENTS, KEPT_EVENTS, EventLog
from clustermcl.protocol.job_events import Ended


def test_the_last_events_are_kept_and_their_numbers_go_on() -> None:
    log = EventLog()
    for step in range(KEPT_EVENTS + 5):
        log.add([Ended(f"c{step}", "merged", ("c0",), 0.1)], step, step * 10)
    kept = tuple(log.kept)
    assert [event.number for event in kept] == list(range(5, KEPT_EVENTS + 5))
    assert kept[0].event == Ended("c5", "merged", ("c0",), 0.1)
    assert (kept[0].step, kept[0].stamp_ns) == (5, 50)
    heir = log.recent()
    assert (heir.kept, heir.count, heir.news()) == (log.kept[-HANDED_ON_EVENTS:], log.count, ())
