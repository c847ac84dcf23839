"""One coordinator process from follower to leader and back."""

import pytest

from clustermcl.coordinator.events import (
    CheckpointArrived,
    Event,
    LinkChanged,
    TimePassed,
    TokenChanged,
    WorkerChanged,
)
from clustermcl.coordinator.instructions import FetchScans, Instruction
from clustermcl.coordinator.replica import (
    GRACE_NS,
    LISTEN_NS,
    PAUSE_NS,
    SETTLE_NS,
    Membership,
    Replica,
)
from clustermcl.protocol.work import Checkpoint
from tests.unit.coordinator.reports import checkpoint, started

MS, SECOND = 1_000_000, 1_000_000_000
SILENCE_S = 2.0
GONE = TokenChanged(None, alive=False)
LINK_DOWN, LINK_UP = LinkChanged(up=False), LinkChanged(up=True)


def state(term: int, serial: int = 0, *, founded: bool = False) -> Checkpoint:
    return checkpoint(term, serial, founded=founded, step=-1)


def leading(replica: Replica, now_ns: int, term: int = 100) -> Replica:
    coordinator = started(now_ns=now_ns, term=term, known=replica.newest).coordinator()
    replica.lead(coordinator, now_ns, coordinator.handle)
    return replica


@pytest.mark.parametrize(
    ("events", "dead_ns"),
    [
        ([(CheckpointArrived(state(1)), SECOND)], 3 * SECOND),
        ([(GONE, SECOND), (CheckpointArrived(state(1)), SECOND + 1)], 3 * SECOND + 1),
        ([(GONE, SECOND), (LINK_DOWN, SECOND + 1), (LINK_UP, 100 * SECOND)], 102 * SECOND),
        ([(CheckpointArrived(state(n)), (3 - n) * SECOND) for n in (2, 1)], 3 * SECOND),
        ([(CheckpointArrived(state(n, founded=n < 2)), n * SECOND) for n in (1, 2)], 4 * SECOND),
        ([(TokenChanged(None, alive=True), 0), (GONE, SECOND)], SECOND + SETTLE_NS),
    ],
    ids=["silent", "state after token", "link lost", "lower term", "it searches", "token gone"],
)
def test_a_follower_leads_after_a_silence_of_the_leader(
    events: list[tuple[Event | TokenChanged | LinkChanged, int]], dead_ns: int
) -> None:
    replica = Replica(SILENCE_S, 0)
    for event, now_ns in events:
        replica.handle(event, now_ns)
    assert not replica.is_leader_dead(dead_ns - 1)
    assert replica.is_leader_dead(dead_ns)


def test_a_leader_is_deposed_by_a_state_of_a_higher_term_and_follows_from_it() -> None:
    replica = leading(Replica(SILENCE_S, 0), 0)
    replica.handle(TimePassed(), 1)
    assert replica.role == "leading"
    assert replica.may_answer(1)
    replica.handle(CheckpointArrived(state(term=50)), 2)
    assert replica.role == "leading", "that one is older"
    decided = replica.handle(CheckpointArrived(state(term=900)), 3)
    assert replica.role == "deposed"
    assert replica.release([*decided, state(100)], 3) == []
    replica.follow(4)
    assert (replica.role, replica.newest) == ("follower", state(term=900))


def test_a_leader_that_was_stopped_publishes_and_answers_nothing_for_the_listening_time() -> None:
    replica = leading(Replica(SILENCE_S, 0), 0)
    replica.handle(TimePassed(), 1)
    woken_ns = PAUSE_NS + 2
    assert not replica.may_answer(woken_ns)
    decided, fetch = [state(100)], FetchScans(1, 2)
    released = replica.release([*decided, fetch], woken_ns + 1)
    assert released == [fetch], "the bridge keeps scans for a limited time"
    later_ns = woken_ns
    while later_ns < woken_ns + LISTEN_NS:
        later_ns += SECOND // 2
        released = replica.release([], later_ns)
    assert released == decided
    assert replica.may_answer(later_ns)


def test_a_leader_decides_nothing_while_it_may_have_lost_reports() -> None:
    replica, decided = Replica(SILENCE_S, 0), list[tuple[Event, int]]()
    coordinator = started(now_ns=0, term=100).coordinator()

    def decide(event: Event, now_ns: int) -> list[Instruction]:
        decided.append((event, now_ns))
        return coordinator.handle(event, now_ns)

    replica.lead(coordinator, 0, decide)
    woken_ns = PAUSE_NS + 1
    lost_ns = woken_ns + LISTEN_NS // 2
    back_ns = lost_ns + 1
    at = [0, woken_ns, back_ns + LISTEN_NS - 1, back_ns + LISTEN_NS, back_ns + LISTEN_NS + 1]
    events = [(TimePassed(), now_ns) for now_ns in at]
    events[2:2] = [(LINK_DOWN, lost_ns), (LINK_UP, back_ns), (TimePassed(), lost_ns + SECOND)]
    for event, now_ns in events:
        replica.handle(event, now_ns)
    changes = [(event, now_ns) for event, now_ns in decided if event in (LINK_DOWN, LINK_UP)]
    assert changes == [(LINK_DOWN, woken_ns), (LINK_UP, back_ns + LISTEN_NS)]


def losing(*workers: str) -> Membership:
    """The tokens of these workers vanish at one second."""
    membership = Membership()
    for worker in workers:
        assert membership.token(worker, True, 0) == [WorkerChanged(worker, "joined")]
        assert membership.token(worker, False, SECOND) == []
    return membership


def test_a_worker_whose_token_vanishes_leaves_after_the_settling_time() -> None:
    membership = losing("a")
    assert membership.left(SECOND + SETTLE_NS - 1) == []
    assert membership.left(SECOND + SETTLE_NS) == [WorkerChanged("a", "left")]
    assert membership.left(2 * SECOND) == []


def test_a_token_that_reappears_within_the_settling_time_shows_a_restart() -> None:
    membership = losing("a")
    changes = membership.token("a", True, SECOND + 10 * MS)
    assert changes == [WorkerChanged("a", "left"), WorkerChanged("a", "joined")]
    assert membership.left(9 * SECOND) == []


def test_no_worker_leaves_while_the_own_link_is_lost_or_in_the_grace_period_after_it() -> None:
    membership = losing("a", "b")  # tokens vanish before the link does
    membership.link(False, SECOND + MS)
    assert membership.left(60 * SECOND) == []
    membership.link(True, 60 * SECOND)
    assert membership.token("a", True, 60 * SECOND + MS) == [WorkerChanged("a", "returned")]
    membership.link(False, 61 * SECOND)
    assert membership.left(99 * SECOND) == []
    membership.link(True, 99 * SECOND)
    assert membership.left(99 * SECOND + GRACE_NS - 1) == [], "it begins again"
    assert membership.left(99 * SECOND + GRACE_NS) == [WorkerChanged("b", "left")]
