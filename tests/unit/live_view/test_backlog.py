"""A slow browser skips frames and takes no more memory for it."""

from live_view.room import MESSAGES_AHEAD, Backlog


def test_a_new_page_gets_all_frames_first() -> None:
    assert Backlog({"map": b"m", "step": b"1"}).take() == [b"m", b"1"]


def test_nothing_is_sent_while_a_slow_page_draws() -> None:
    backlog = Backlog({"step": b"1"})
    backlog.take()
    backlog.on_drawn(1, slow=True)
    backlog.offer({"step": b"2"})
    assert backlog.take() == [b"2"]
    backlog.offer({"step": b"3"})
    assert backlog.take() == []
    backlog.on_drawn(1, slow=True)
    assert backlog.take() == [b"3"]


def test_a_fast_page_acknowledges_several_messages_at_once() -> None:
    backlog = Backlog({})
    sent = 0
    while sent < 100:  # it says nothing at all
        backlog.offer({"step": b"%d" % sent})
        if not backlog.take():
            break
        sent += 1
    assert sent == MESSAGES_AHEAD
    backlog.on_drawn(sent, slow=False)
    assert backlog.take() == [b"%d" % sent]


def test_a_slow_page_gets_only_the_newest_of_each_topic() -> None:
    backlog = Backlog({})
    for number in range(1000):
        backlog.offer({"step": b"%d" % number, "pose": b"p"})
    assert backlog.take() == [b"999", b"p"]


def test_nothing_is_sent_without_a_new_frame() -> None:
    backlog = Backlog({})
    assert backlog.take() == []
    backlog.offer({"step": b"1"})
    assert backlog.take() == [b"1"]
