from zenoh_link.stale_session import STALE_NS, StaleSessionDetector
from zenoh_link.wire import Link, Received, Token

LOST, BACK = Link(up=False), Link(up=True)
SECOND = 1_000_000_000


def after(*events: object) -> StaleSessionDetector:
    """What happened second by second."""
    link = StaleSessionDetector()
    for at_s, event in enumerate(events):
        link.on_event(event, at_s * SECOND)
    return link


def test_a_link_that_came_back_is_suspect_when_nothing_has_come_through_it_for_long() -> None:
    link = after(BACK, Received("scan", b""), LOST, BACK)
    assert not link.is_suspect(3 * SECOND + STALE_NS - 1)
    assert link.is_suspect(3 * SECOND + STALE_NS)
    assert not link.is_suspect(4 * SECOND + STALE_NS), "it is looked at again after as long only"
    assert link.is_suspect(3 * SECOND + 2 * STALE_NS)


def test_one_that_was_never_lost_may_be_silent() -> None:
    assert not after(BACK).is_suspect(100 * STALE_NS)
    assert not after(BACK, None, Token("worker/w/alive", alive=False)).is_suspect(100 * STALE_NS)


def test_one_that_is_lost_is_waited_for() -> None:
    link = after(BACK, LOST)
    assert not link.is_armed
    assert not link.is_suspect(100 * STALE_NS)


def test_whatever_comes_through_it_shows_that_it_carries() -> None:
    for event in (Received("scan", b""), Token("coordinator/alive", alive=True), b"a checkpoint"):
        link = after(BACK, LOST, BACK, event)
        assert not link.is_armed
        assert not link.is_suspect(100 * STALE_NS)


def test_tokens_that_vanish_with_the_link_show_nothing_whenever_they_are_heard_of() -> None:
    gone = Token("coordinator/alive", alive=False)
    for events in ((gone, LOST, BACK), (LOST, gone, BACK), (LOST, BACK, gone)):
        assert after(BACK, *events).is_armed
