import math

from msgspec.structs import replace

from clustermcl.coordinator.instructions import FetchScans
from clustermcl.coordinator.recovery import (
    APART_US,
    KNOWN_NS,
    SILENT_NS,
    UNKNOWN_NS,
    UNSEEN_NS,
    StateRecovery,
    Term,
)
from clustermcl.coordinator.report_checks import without_malformed_jobs
from clustermcl.protocol.work import (
    MAX_RELAYED_AHEAD_US,
    Assignment,
    Checkpoint,
    ElsewhereJob,
    OrderAnswer,
    TakeOver,
    TrackJob,
    WorkerState,
    check_term,
)
from tests.unit.coordinator.reports import checkpoint, cloud_at, scan

BEGAN_NS = 5_000_000_000
KNOWN = KEPT = checkpoint(1, step=3)
NOTHING = WorkerState(sender="w", term=0, holds=())


def of_it(terms: tuple[int, ...] = (1, 9), founded: int = 1) -> WorkerState:
    """From a worker of the coordinator that wrote the file, by default."""
    return replace(NOTHING, term=9, terms=terms, founded=founded)


def asked(
    *workers: str, known: Checkpoint | None = None, kept: Checkpoint | None = None
) -> StateRecovery:
    recovery = StateRecovery("c", BEGAN_NS, [known] if known else [], kept)
    for worker in workers:
        recovery.expect(worker)
    return recovery


def is_over_after(recovery: StateRecovery, wait_ns: int) -> bool:
    """Whether it ends after this time and not earlier."""
    return recovery.is_over(BEGAN_NS + wait_ns) and not recovery.is_over(BEGAN_NS + wait_ns - 1)


def test_recovery_ends_when_all_workers_have_answered() -> None:
    recovery = asked("w1")
    assert not recovery.is_over(BEGAN_NS)
    recovery.on_answer("w1", NOTHING)
    assert recovery.is_over(BEGAN_NS)


def test_recovery_with_a_founded_state_waits_briefly_for_the_last_worker() -> None:
    assert is_over_after(asked("w1", "w2", known=KNOWN), KNOWN_NS)
    knows_nothing = replace(KNOWN, founded=False)
    assert is_over_after(asked("w1", "w2", known=knows_nothing), SILENT_NS)


def test_recovery_without_a_founded_state_waits_for_silent_busy_workers() -> None:
    recovery = asked("w1", "w2", "w3")
    assert is_over_after(recovery, SILENT_NS)
    recovery.on_answer("w1", NOTHING)  # it was just started
    assert is_over_after(recovery, SILENT_NS)
    recovery.on_answer("w2", NOTHING)
    assert is_over_after(recovery, UNKNOWN_NS)


def test_the_file_counts_once_a_worker_has_received_its_term() -> None:
    recovery = asked("w1", "w2", kept=KEPT)
    assert recovery.checkpoints == [], "all may have been started again"
    assert is_over_after(recovery, SILENT_NS)
    recovery.on_answer("w1", of_it(terms=(9,), founded=0))
    assert recovery.checkpoints == []
    recovery.on_answer("w2", of_it())
    assert recovery.checkpoints == [KEPT]
    recovery.forget("w2")
    assert recovery.checkpoints == [KEPT], "also when that one has gone since"


def test_the_file_counts_once_the_bridge_shows_its_last_scan() -> None:
    other = replace(scan(3), stamp_ns=1)  # of a bridge that restarted its count of steps
    for found, counts in (((), False), ((scan(2),), False), ((other,), False), ((scan(3),), True)):
        recovery = StateRecovery("c", BEGAN_NS, [], KEPT, scan(3))
        assert recovery.questions(7, BEGAN_NS) == [FetchScans(3, 3)]
        assert recovery.questions(7, BEGAN_NS) == [], "it was asked just now"
        assert is_over_after(recovery, KNOWN_NS), "the bridge may be dead too"
        recovery.on_history(found)
        assert recovery.is_over(BEGAN_NS)
        assert recovery.checkpoints == [KEPT] * counts
        assert recovery.questions(7, BEGAN_NS + KNOWN_NS) == []


def test_the_file_counts_unless_a_later_coordinator_had_a_belief() -> None:
    recovery = asked("w1", "w2", kept=KEPT)
    recovery.on_answer("w1", of_it(terms=(1, 5, 9)))
    assert recovery.checkpoints == [KEPT]
    recovery.on_answer("w2", of_it(terms=(1, 5, 9), founded=5))
    assert recovery.checkpoints == []


def test_states_without_places_replace_no_state_with_places() -> None:
    recovery = asked("w1", known=KNOWN)
    for serial in range(10):
        recovery.on_checkpoint(replace(KNOWN, term=7, serial=serial, founded=False))
    assert recovery.checkpoints[0] == KNOWN


def test_only_impossible_jobs_of_a_worker_are_left_out() -> None:
    good = Assignment(job_id="e0", epoch=3, job=ElsewhereJob(first_step=4))
    nan = cloud_at((math.nan, 0.0, 0.0), 3)
    beyond = replace(good, job=TrackJob(cluster=1, start=nan, exact=True))
    reported = WorkerState(
        sender="w", term=7, holds=(beyond, good),
        terms=(1, 7), founded=1,
    )  # fmt: skip
    read = without_malformed_jobs(reported)
    assert read.holds == (good,)
    assert (read.terms, read.founded) == ((1, 7), 1)


OTHER = 8
"""Term of another coordinator."""


def test_a_term_is_raised_above_all_received_terms_before_it_begins() -> None:
    term = Term(5)
    assert term.on_term(OTHER)
    raised = term.number
    assert raised > OTHER
    assert not term.on_term(raised), "that is its own"
    assert term.on_term(raised + 20)
    assert term.number > raised + 20
    assert term.outranked_by is None
    close = Term(OTHER + 3)
    assert close.on_term(OTHER), "it began a moment before, and may have given jobs since"
    assert close.number >= OTHER + APART_US


def test_a_term_that_has_begun_is_outranked_by_the_highest_received_term() -> None:
    term = Term(5)
    term.begun = True
    assert not term.on_term(5)
    assert term.outranked_by is None
    assert not term.on_term(7), "it stays as it is"
    term.on_term(6)
    assert (term.number, term.outranked_by) == (5, 7)


def test_a_workers_term_deposes_no_coordinator_but_raises_the_term_later() -> None:
    term = Term(5)
    term.begun = True
    term.on_worker_term(9, now_ns=0)
    term.on_worker_term(8, now_ns=1)
    assert not term.rises_above_workers(UNSEEN_NS - 1)
    assert (term.number, term.outranked_by) == (5, None)
    assert term.rises_above_workers(UNSEEN_NS)
    assert term.number > 9
    assert not term.rises_above_workers(2 * UNSEEN_NS)


def test_a_claimed_term_leaves_room_for_higher_terms() -> None:
    term = Term(1_000)
    claimed = OrderAnswer(sender="w", order=1, jobs=(), term=MAX_RELAYED_AHEAD_US)
    for _ in range(100):
        check_term(claimed, clock_ns=0)
        term.on_term(claimed.term)
        assert not term.on_term(term.number)
    check_term(TakeOver(sender="c", term=term.number), clock_ns=0)
