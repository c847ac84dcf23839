"""One coordinator process from follower to leader and back."""

import pytest

from clustermcl.coordinator.events import (
    CheckpointArrived,
    Event,
    LinkChanged,
    TimePassed,
    TokenChanged,
)
from clustermcl.coordinator.instructions import AskState, FetchScans, Instruction
from clustermcl.coordinator.replica import LISTEN_NS, PAUSE_NS, SETTLE_NS, Replica
from clustermcl.protocol.work import Checkpoint
from tests.unit.coordinator.reports import checkpoint, started

SECOND = 1_000_000_000
SILENCE_S = 2.0
GONE = TokenChanged(None, alive=False)
LINK_DOWN, LINK_UP = LinkChanged(up=False), LinkChanged(up=True)


def state(term: int, serial: int = 0) -> Checkpoint:
    return checkpoint(term, serial, founded=False, step=-1)


def leading(replica: Replica, now_ns: int, term: int = 100) -> Replica:
    begun = started(now_ns=now_ns, term=term, known=replica.newest.checkpoint)
    replica.lead(begun.coordinator(), now_ns)
    return replica


def test_a_follower_leads_when_the_leaders_token_vanishes_and_the_link_stays() -> None:
    replica = Replica(SILENCE_S, 0)
    replica.handle(TokenChanged(None, alive=True), 0)
    replica.handle(TokenChanged(None, alive=False), SECOND)
    assert not replica.is_leader_dead(SECOND + SETTLE_NS - 1)
    assert replica.is_leader_dead(SECOND + SETTLE_NS)
    replica.handle(LinkChanged(up=False), SECOND + SETTLE_NS)
    assert not replica.is_leader_dead(60 * SECOND), "it has lost its own link"


@pytest.mark.parametrize(
    ("events", "dead_ns"),
    [
        ([(CheckpointArrived(state(1)), SECOND)], 3 * SECOND),
        ([(GONE, SECOND), (CheckpointArrived(state(1)), SECOND + 1)], 3 * SECOND + 1),
        ([(GONE, SECOND), (LINK_DOWN, SECOND + 1), (LINK_UP, 100 * SECOND)], 102 * SECOND),
    ],
    ids=["it is silent", "its state arrives after its token is gone", "the own link was lost"],
)
def test_a_follower_leads_after_a_silence_of_the_leader(
    events: list[tuple[Event | TokenChanged | LinkChanged, int]], dead_ns: int
) -> None:
    replica = Replica(SILENCE_S, 0)
    for event, now_ns in events:
        replica.handle(event, now_ns)
    assert not replica.is_leader_dead(dead_ns - 1)
    assert replica.is_leader_dead(dead_ns)


def test_a_new_leader_asks_its_workers_and_rises_above_the_term_that_it_followed() -> None:
    replica = Replica(SILENCE_S, 0)
    replica.handle(CheckpointArrived(state(term=500)), 0)
    leading(replica, SECOND, term=100)
    assert replica.role == "recovering"
    decided = replica.handle(TokenChanged("w0", alive=True), SECOND)
    (ask,) = [do for do in replica.release(decided, SECOND) if isinstance(do, AskState)]
    assert ask.question.term > 500
    assert not replica.may_answer(SECOND)


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
    assert (replica.role, replica.newest.checkpoint) == ("follower", state(term=900))


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


def test_a_state_of_a_lower_term_is_no_sign_of_life() -> None:
    replica = Replica(SILENCE_S, 0)
    replica.handle(CheckpointArrived(state(term=2)), SECOND)
    replica.handle(CheckpointArrived(state(term=1)), 2 * SECOND)
    assert replica.newest.checkpoint == state(term=2)
    assert replica.is_leader_dead(3 * SECOND)
