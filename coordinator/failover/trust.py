"""Whose word on terms and checkpoints counts: that of those who may coordinate.

Workers keep what coordinators have said and tell it to the next one; they could also make it up.
So coordinators that have a key sign what is handed on, and believe nothing that is not signed.
Without a key, as on loopback, where everybody is trusted, all is believed that can be.
"""

import hashlib
import hmac
from collections.abc import Callable
from typing import TypeVar

import msgspec
from msgspec.structs import replace

from protocol.errors import MalformedMessageError
from protocol.terms import check_term
from protocol.work import Checkpoint, OrderAnswer, TakeOver, WorkerState, WorkOrder

M = TypeVar("M", Checkpoint, TakeOver, WorkOrder)


class Trust:
    """Signs what this coordinator hands on, and judges what others say that one has.

    Args:
        key: that all coordinators of the robot have, and nobody else; None: nothing is signed.
        robot: whose coordinator this is; what is signed for one robot is worth nothing to another.
        clock_ns: this machine's clock, since 1970.
        refused: told of everything that is not believed.
    """

    def __init__(
        self,
        key: bytes | None,
        robot: str,
        clock_ns: Callable[[], int],
        refused: Callable[[MalformedMessageError], object],
    ) -> None:
        self._key, self._robot = key, robot
        self._clock_ns, self._refused = clock_ns, refused

    def signed(self, message: M) -> M:
        """A message of this coordinator with the proof of its term; a checkpoint as a whole."""
        message = replace(message, term_proof=self._of_term(message.term))
        if isinstance(message, Checkpoint):
            return replace(message, signature=self._of_checkpoint(message))
        return message

    def believes(self, checkpoint: Checkpoint) -> bool:
        """Whether a coordinator can have made this checkpoint."""
        good = hmac.compare_digest(checkpoint.signature, self._of_checkpoint(checkpoint))
        return self._is_proven(checkpoint, signed=good)

    def term(self, told: OrderAnswer | WorkerState) -> int:
        """The highest term of a coordinator that a worker knows of; 0 where it cannot prove it."""
        good = hmac.compare_digest(told.term_proof, self._of_term(told.term))
        return told.term if self._is_proven(told, signed=good or told.term == 0) else 0

    def _is_proven(self, message: Checkpoint | OrderAnswer | WorkerState, *, signed: bool) -> bool:
        try:
            check_term(message, self._clock_ns())
        except MalformedMessageError as error:
            self._refused(error)
            return False
        if self._key is not None and not signed:
            kind = type(message).__name__
            problem = f"term {message.term} without a coordinator's signature"
            self._refused(MalformedMessageError(expected=kind, problem=problem, kind="not signed"))
            return False
        return True

    def _of_term(self, term: int) -> bytes:
        return self._signature("term", term)

    def _of_checkpoint(self, checkpoint: Checkpoint) -> bytes:
        return self._signature(
            *("checkpoint", checkpoint.term, checkpoint.serial, checkpoint.step),
            *(checkpoint.founded, checkpoint.state),
        )

    def _signature(self, *facts: object) -> bytes:
        if self._key is None:
            return b""
        text = msgspec.msgpack.encode((self._robot, *facts))
        return hmac.digest(self._key, text, hashlib.sha256)
