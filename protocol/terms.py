"""Which terms can be: a forged one above all others would be the last."""

from protocol.errors import MalformedMessageError
from protocol.work import Checkpoint, OrderAnswer, TakeOver, WorkerState, WorkOrder

MAX_AHEAD_US = 100 * 365 * 86_400 * 1_000_000
"""How far a term may stand above one's own clock, and so how far apart clocks may be [us].

A hundred years: a machine without a battery begins in 1970 and must still obey a coordinator of
today. And little enough: `2**53`, beyond which there is no number, is in the year 2255, so a
coordinator can stand above any term that is believed, and be believed.
"""


def check_term(
    message: WorkOrder | OrderAnswer | Checkpoint | TakeOver | WorkerState, clock_ns: int
) -> None:
    """Refuse what tells of a term that no coordinator can have had.

    Args:
        message: from the wire.
        clock_ns: this machine's, since 1970.

    Raises:
        MalformedMessageError: its term is too far above the clock.
    """
    clock_us = clock_ns // 1_000
    if message.term > clock_us + MAX_AHEAD_US:
        raise MalformedMessageError(
            expected=type(message).__name__,
            problem=f"term {message.term} is more than a hundred years above the clock, {clock_us}",
            kind="term far ahead",
        )
