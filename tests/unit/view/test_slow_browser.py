from clustermcl.view.commands import Drawn
from clustermcl.view.room import MESSAGES_AHEAD, Browser


class _Page:
    def __init__(self) -> None:
        self.received: list[bytes] = []
        self.browser = Browser(self.received.append)


def test_nothing_is_sent_while_a_slow_page_draws() -> None:
    page = _Page()
    page.browser.offer({"map": b"m", "step": b"1"})
    page.browser.on_drawn(Drawn(1, slow=True))
    page.browser.offer({"step": b"2"})
    page.browser.offer({"step": b"3"})
    assert page.received == [b"{m,1}", b"{2}"], "a new page gets all frames in one message"
    for _ in range(2):  # the second has no new frame to send
        page.browser.on_drawn(Drawn(1, slow=True))
        assert page.received == [b"{m,1}", b"{2}", b"{3}"]


def test_a_fast_page_may_acknowledge_several_messages_together() -> None:
    page = _Page()
    for number in range(100):
        page.browser.offer({"step": b"%d" % number})
    assert len(page.received) == MESSAGES_AHEAD
    page.browser.on_drawn(Drawn(MESSAGES_AHEAD))
    assert page.received[MESSAGES_AHEAD:] == [b"{99}"]


def test_only_the_newest_frame_of_each_topic_waits() -> None:
    page = _Page()
    for number in range(1000):
        page.browser.offer({"step": b"%d" % number, "pose": b"p"})
    del page.received[:]
    page.browser.on_drawn(Drawn(1))
    assert page.received == [b"{999,p}"]
