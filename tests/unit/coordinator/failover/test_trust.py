"""Terms and checkpoints are believed only of those who have the coordinators' key."""

from msgspec.structs import replace

from coordinator.failover.trust import Trust
from protocol.work import Checkpoint, OrderAnswer, TakeOver, WorkerState, WorkOrder

KEY, OTHER_KEY = b"k" * 32, b"o" * 32
CHECKPOINT = Checkpoint(sender="c", term=7, serial=3, step=2, founded=True, state=b"state")
TAKE_OVER = TakeOver(sender="c", term=7)


class Judge:
    """A coordinator's trust, and the causes for which it believed nothing."""

    def __init__(self, key: bytes | None = KEY, robot: str = "robot") -> None:
        self.causes: list[str] = []
        self.trust = Trust(key, robot, lambda: 0, lambda error: self.causes.append(error.cause))


def answer(term: int, proof: bytes) -> OrderAnswer:
    return OrderAnswer(sender="w", order=1, jobs=(), term=term, term_proof=proof)


def state(term: int, proof: bytes) -> WorkerState:
    return WorkerState(sender="w", term=term, term_proof=proof, holds=(), reports=())


def test_what_one_coordinator_has_signed_the_others_believe() -> None:
    one, other = Judge(), Judge()
    assert other.trust.believes(one.trust.signed(CHECKPOINT))
    order = WorkOrder(
        sender="c", order=1, term=7, map_digest="", filter_settings={}, snapshot_every_steps=1,
        keep=(), begin=(),
    )  # fmt: skip
    for message in (TAKE_OVER, order, CHECKPOINT):
        proof = one.trust.signed(message).term_proof
        assert other.trust.term(answer(7, proof)) == 7
        assert other.trust.term(state(7, proof)) == 7
    assert other.causes == []


def test_a_worker_can_keep_a_checkpoint_and_change_nothing_of_it() -> None:
    judge = Judge()
    signed = judge.trust.signed(CHECKPOINT)
    for field, value in (
        ("term", 8), ("serial", 4), ("step", 3), ("founded", False), ("state", b"other"),
        ("signature", b""), ("signature", b"x" * 32),
    ):  # fmt: skip
        assert not judge.trust.believes(replace(signed, **{field: value})), field
    assert judge.causes == ["malformed Checkpoint: not signed"] * 7


def test_a_term_without_a_coordinators_proof_is_none() -> None:
    judge = Judge()
    proof = judge.trust.signed(TAKE_OVER).term_proof
    assert judge.trust.term(answer(8, proof)) == 0, "of another term"
    assert judge.trust.term(state(8, b"")) == 0
    assert judge.causes == [
        "malformed OrderAnswer: not signed",
        "malformed WorkerState: not signed",
    ]
    assert judge.trust.term(answer(0, b"")) == 0
    assert len(judge.causes) == 2, "who knows of no term says nothing wrong"


def test_neither_another_key_nor_another_robot_nor_a_term_signs_a_checkpoint() -> None:
    judge = Judge()
    for key, robot in ((OTHER_KEY, "robot"), (KEY, "robot-2"), (None, "robot")):
        signed = Judge(key, robot).trust.signed(CHECKPOINT)
        assert not judge.trust.believes(signed)
        assert judge.trust.term(answer(7, signed.term_proof)) == 0
    signed = judge.trust.signed(CHECKPOINT)
    assert not judge.trust.believes(replace(signed, signature=signed.term_proof))


def test_without_a_key_nothing_is_signed_and_all_is_believed_that_can_be() -> None:
    judge = Judge(None)
    assert judge.trust.signed(CHECKPOINT) == CHECKPOINT
    assert judge.trust.believes(CHECKPOINT)
    assert judge.trust.term(answer(9, b"")) == 9
    assert not judge.trust.believes(replace(CHECKPOINT, term=2**53 - 1))
    assert judge.trust.term(answer(2**53 - 1, b"")) == 0
    assert [cause.rpartition(": ")[2] for cause in judge.causes] == ["term far ahead"] * 2
