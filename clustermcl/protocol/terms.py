"""Limit for terms: a forged term with the highest number could never be exceeded."""

from clustermcl.protocol.errors import MalformedMessageError
from clustermcl.protocol.work import Checkpoint, OrderAnswer, TakeOver, WorkerState, WorkOrder

MAX_AHEAD_US = 100 * 365 * 86_400 * 1_000_000
"""How far a term may be ahead of the local clock [us]: a machine without a battery starts in 1970
and must accept a term of today. The limit of valid terms, `2**53`, is the year 2255."""
MAX_RELAYED_AHEAD_US = 3 * MAX_AHEAD_US // 4
"""The same for a term that a worker relays, so that a new coordinator can choose a higher one."""


def check_term(
    message: WorkOrder | OrderAnswer | Checkpoint | TakeOver | WorkerState, clock_ns: int
) -> None:
    """Raise `MalformedMessageError` for a term too far ahead of the clock, the time since 1970."""
    clock_us = clock_ns // 1_000
    is_relayed = isinstance(message, OrderAnswer | WorkerState)
    most_us = MAX_RELAYED_AHEAD_US if is_relayed else MAX_AHEAD_US
    if message.term > clock_us + most_us:
        years = most_us // (MAX_AHEAD_US // 100)
        raise MalformedMessageError(
            expected=type(message).__name__,
            problem=f"term {message.term} is over {years} years ahead of the clock, {clock_us}",
            kind="term far ahead",
        )
