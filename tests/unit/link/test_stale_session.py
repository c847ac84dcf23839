import pytest

from clustermcl.link.stale_session import STALE_NS, StaleSessionDetector
from clustermcl.link.wire import Link, Received, Token

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


GONE = Token("coordinator/alive", alive=False)


@pytest.mark.parametrize(("events", "is_armed"), [
    ((BACK,), False),
    ((BACK, None, Token("worker/w/alive", alive=False)), False),
    ((BACK, LOST), False),
    ((BACK, LOST, BACK, Received("scan", b"")), False),
    ((BACK, LOST, BACK, Token("coordinator/alive", alive=True)), False),
    ((BACK, LOST, BACK, b"a checkpoint"), False),
    ((BACK, GONE, LOST, BACK), True),
    ((BACK, LOST, GONE, BACK), True),
    ((BACK, LOST, BACK, GONE), True),
], ids=[
    "a link that was never lost", "tokens alone", "the link is down", "a message clears it",
    "a token that appears clears it", "a state clears it", "tokens that went before the link",
    "with the link", "and after it do not",
])  # fmt: skip
def test_a_session_is_suspect_only_after_its_link_returned_and_nothing_arrived(
    events: tuple[object, ...], is_armed: bool
) -> None:
    link = after(*events)
    assert link.is_armed == is_armed
    assert link.is_suspect(100 * STALE_NS) == is_armed
