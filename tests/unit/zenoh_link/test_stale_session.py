from zenoh_link.stale_session import STALE_NS, StaleSessionDetector
from zenoh_link.wire import Link, Received, Token

LOST, BACK = Link(up=False), Link(up=True)
SECOND = 1_000_000_000


def after(*events: object) -> StaleSessionDetector:
    """Give one event a second to a detector."""
    link = StaleSessionDetector()
    for at_s, event in enumerate(events):
        link.on_event(event, at_s * SECOND)
    return link


def test_a_session_is_suspect_when_it_receives_nothing_after_its_link_returns() -> None:
    link = after(BACK, Received("scan", b""), LOST, BACK)
    assert not link.is_suspect(3 * SECOND + STALE_NS - 1)
    assert link.is_suspect(3 * SECOND + STALE_NS)
    assert not link.is_suspect(4 * SECOND + STALE_NS), "the next look waits as long again"
    assert link.is_suspect(3 * SECOND + 2 * STALE_NS)


def test_a_session_whose_link_was_never_lost_may_receive_nothing() -> None:
    assert not after(BACK).is_suspect(100 * STALE_NS)
    assert not after(BACK, None, Token("worker/w/alive", alive=False)).is_suspect(100 * STALE_NS)


def test_a_session_is_not_suspect_while_its_link_is_down() -> None:
    link = after(BACK, LOST)
    assert not link.is_armed
    assert not link.is_suspect(100 * STALE_NS)


def test_any_received_message_clears_the_suspicion() -> None:
    for event in (Received("scan", b""), Token("coordinator/alive", alive=True), b"a checkpoint"):
        link = after(BACK, LOST, BACK, event)
        assert not link.is_armed
        assert not link.is_suspect(100 * STALE_NS)


def test_tokens_that_disappear_with_the_link_do_not_clear_the_suspicion() -> None:
    gone = Token("coordinator/alive", alive=False)
    for events in ((gone, LOST, BACK), (LOST, gone, BACK), (LOST, BACK, gone)):
        assert after(BACK, *events).is_armed
