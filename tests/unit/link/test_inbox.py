import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

from hypothesis import given
from hypothesis import strategies as st

from clustermcl.link.inbox import Inbox

PUTS = st.lists(st.tuples(st.sampled_from(["scan", "odometry", "event"]), st.integers()))


def drain(inbox: Inbox[tuple[str, int]]) -> list[tuple[str, int]]:
    taken = []
    while (item := inbox.get(0.0)) is not None:
        taken.append(item)
    return taken


@given(puts=PUTS, scans=st.integers(1, 4), odometries=st.integers(1, 4), events=st.integers(1, 9))
def test_kept_events_are_returned_in_the_order_of_arrival(
    puts: list[tuple[str, int]], scans: int, odometries: int, events: int
) -> None:
    inbox: Inbox[tuple[str, int]] = Inbox(
        {"scan": scans, "odometry": odometries}, max_events=events
    )
    accepted = []
    for kind, number in puts:
        if kind == "event":
            accepted.append(inbox.put((kind, number)))
        else:
            inbox.put_newest(kind, (kind, number))
    assert accepted == [number < events for number in range(len(accepted))]
    numbered = list(enumerate(puts))
    kept = [item for item in numbered if item[1][0] == "event"][:events]  # the first
    for kind, bound in (("scan", scans), ("odometry", odometries)):
        kept += [item for item in numbered if item[1][0] == kind][-bound:]  # the newest
    assert drain(inbox) == [put for _, put in sorted(kept)]
    wanted = [put for put in puts if (put[0], scans) != ("scan", 1)]
    wanted = [put for put in wanted if (put[0], odometries) != ("odometry", 1)]
    lost = len(wanted) - sum(put in wanted for _, put in kept)
    assert sum(inbox.dropped().values()) == lost


def test_nothing_comes_from_an_empty_inbox_once_the_time_is_up() -> None:
    started_s = time.monotonic()
    assert Inbox[str]({}).get(0.02) is None
    assert time.monotonic() - started_s >= 0.02


def test_many_threads_lose_nothing_and_keep_their_own_order() -> None:
    inbox: Inbox[tuple[int, int]] = Inbox({}, max_events=100_000)

    def put_all(thread: int) -> None:
        for number in range(2000):
            inbox.put((thread, number))

    with ThreadPoolExecutor(4) as pool:
        pool.map(put_all, range(4))
        taken = list(filter(None, (inbox.get(10.0) for _ in range(8000))))
    for i in range(4):
        assert [number for thread, number in taken if thread == i] == list(range(2000))


@dataclass(frozen=True)
class Heavy:
    payload: bytes


def test_large_states_give_way_to_newer_ones_by_their_bytes() -> None:
    inbox: Inbox[Heavy] = Inbox({"report": 100}, max_kind_bytes=1000)
    for number in range(10):
        inbox.put_newest("report", Heavy(bytes([number]) * 400))
    left = [heavy.payload[0] for heavy in iter(lambda: inbox.get(0.0), None)]
    assert left == [8, 9]
    assert inbox.dropped() == {"report": 8}
    inbox.put_newest("report", Heavy(b"1" * 5000))  # alone it may be larger
    assert inbox.get(0.0) is not None


def test_large_events_are_refused_by_their_bytes() -> None:
    inbox: Inbox[Heavy] = Inbox({"report": 100}, max_kind_bytes=1000)
    assert [inbox.put(Heavy(bytes(400))) for _ in range(3)] == [True, True, False]
    assert inbox.get(0.0) is not None
    assert inbox.put(Heavy(bytes(400)))
    inbox.count_refused("query")
    assert inbox.dropped() == {"event": 1, "query too large": 1}


def test_what_a_process_sends_itself_is_never_refused() -> None:
    """Strangers fill the inbox with questions; a timer that is refused then never comes again."""
    inbox: Inbox[str] = Inbox({}, max_events=1)
    assert [inbox.put("question") for _ in range(2)] == [True, False]
    inbox.put_own("timer")
    assert not inbox.put("question")
    assert [inbox.get(0.0) for _ in range(2)] == ["question", "timer"]
    assert inbox.put("a taken event leaves room")
