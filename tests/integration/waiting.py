"""Waiting for a condition instead of sleeping, with the patience that a busy machine needs."""

import os
import threading
import time
from collections.abc import Callable
from typing import TypeVar

import pytest
import zenoh
from msgspec.structs import replace

from clustermcl.link.wire import ask
from clustermcl.protocol.errors import RefusedError, UnreachableError
from clustermcl.protocol.message import Message
from clustermcl.runtime.settings import Settings, ZenohSettings

M = TypeVar("M", bound=Message)

PATIENCE_S = 240.0
"""Time-out of whatever ends by itself [s]; a passing test does not wait it out."""
SLACK = 3.0
"""A slower machine than the developers' may take this many times a promised time."""
_POLL_S = 0.005


def wait_until(condition: Callable[[], object], deadline_s: float = PATIENCE_S) -> None:
    """Return as soon as the condition holds; fail the test if it does not hold in time."""
    until_s = time.monotonic() + deadline_s
    nap = threading.Event()
    while not condition():
        if time.monotonic() >= until_s:
            pytest.fail(f"{condition} did not hold within {deadline_s:g} s")
        nap.wait(_POLL_S)


def answered(
    session: zenoh.Session, key: str, answer: type[M], message: Message | None = None
) -> M:
    """Query `key` until a process answers or refuses; return the answer or raise `RefusedError`.

    A query that is sent before the declaration of the answering process has spread fails at once,
    or reaches only a process that never answers.
    """
    answers: list[M] = []

    def is_answered() -> bool:
        timeout_s = stretched_s(1.0)
        try:
            answers.append(ask(session, key, answer, timeout_s=timeout_s, message=message))
        except RefusedError:
            raise
        except UnreachableError:
            return False
        return True

    wait_until(is_answered)
    return answers[0]


def stretched_s(promised_s: float) -> float:
    """Return the bound for a promised time: `SLACK` times it, times the processes per core."""
    return promised_s * SLACK * max(1.0, os.getloadavg()[0] / (os.cpu_count() or 1))


def patient(zenoh: ZenohSettings) -> ZenohSettings:
    """Return the settings of a client that a busy machine does not time out."""
    return replace(zenoh, connect_timeout_s=PATIENCE_S, query_timeout_s=20.0)


def patient_client(settings: Settings) -> Settings:
    return replace(settings, zenoh=patient(settings.zenoh))
