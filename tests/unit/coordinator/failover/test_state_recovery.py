from msgspec.structs import replace

from coordinator.failover.state_recovery import (
    KNOWN_NS,
    SILENT_NS,
    UNKNOWN_NS,
    StateRecovery,
    Told,
    told_by,
)
from coordinator.failover.trust import Trust
from protocol.codec import encode
from protocol.validity import MAX_STEP
from protocol.work import Assignment, Checkpoint, ElsewhereJob, WorkerState
from tests.unit.coordinator.reports import elsewhere

BEGAN_NS = 5_000_000_000
KNOWN = Checkpoint(sender="d", term=1, serial=1, step=3, founded=True, state=b"")
NOTHING = Told(term=0, holds=(), checkpoint=None, reports=())


def asked(*workers: str, known: Checkpoint | None = None) -> StateRecovery:
    recovery = StateRecovery("c", known, BEGAN_NS)
    for worker in workers:
        recovery.expect(worker)
    return recovery


def is_over_after(recovery: StateRecovery, wait_ns: int) -> bool:
    """It is, after so long and not a moment before."""
    return recovery.is_over(BEGAN_NS + wait_ns) and not recovery.is_over(BEGAN_NS + wait_ns - 1)


def test_who_has_heard_all_waits_no_longer() -> None:
    recovery = asked("w1")
    assert not recovery.is_over(BEGAN_NS)
    recovery.answered("w1", NOTHING)
    assert recovery.is_over(BEGAN_NS)


def test_with_a_checkpoint_in_hand_the_last_worker_is_hardly_waited_for() -> None:
    assert is_over_after(asked("w1", "w2", known=KNOWN), KNOWN_NS)
    knows_nothing = replace(KNOWN, founded=False)
    assert is_over_after(asked("w1", "w2", known=knows_nothing), SILENT_NS)


def test_busy_workers_that_are_silent_are_waited_for_lest_all_is_forgotten() -> None:
    recovery = asked("w1", "w2", "w3")
    assert is_over_after(recovery, SILENT_NS)
    recovery.answered("w1", NOTHING)  # it was just started
    assert is_over_after(recovery, SILENT_NS)
    recovery.answered("w2", NOTHING)
    assert is_over_after(recovery, UNKNOWN_NS)


def test_what_a_worker_has_told_counts_also_when_it_has_started_anew_and_knows_nothing() -> None:
    recovery, older = asked("w1"), replace(KNOWN, step=2, serial=0)
    recovery.answered("w1", replace(NOTHING, checkpoint=KNOWN))
    recovery.ask_all_again()
    recovery.answered("w1", NOTHING)
    recovery.answered("w1", replace(NOTHING, checkpoint=older))
    assert recovery.checkpoints == [KNOWN, older]


def test_of_what_a_worker_holds_only_what_cannot_be_is_left_out() -> None:
    good = Assignment(job_id="e0", epoch=3, job=ElsewhereJob(first_step=4))
    beyond = replace(good, job=ElsewhereJob(first_step=MAX_STEP))
    told = WorkerState(
        sender="w", term=7, incarnation=1, holds=(beyond, good),
        checkpoint=encode(KNOWN), reports=(encode(elsewhere(3, -1.0)), b"no report"),
    )  # fmt: skip
    read = told_by(encode(told), Trust(None, "robot", lambda: 0, lambda _: None))
    assert read.holds == (good,)
    assert read.checkpoint == KNOWN
    assert read.reports == (elsewhere(3, -1.0),)
