"""Opens the Zenoh session: waits for the router, stays interruptible, closes on exit."""

import logging
import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import zenoh

from clustermcl.link.configuration import CONNECT_TRY_MS, as_zenoh, client_configuration
from clustermcl.protocol.errors import UnreachableError
from clustermcl.runtime.settings import RobotSettings, ZenohSettings
from clustermcl.runtime.stop import StopFlag

_log = logging.getLogger(__name__)

_PAUSE_S = 0.2
VARIABLE = "ZENOH_RUNTIME"
"""Environment variable, the only way to set Zenoh's number of receiving threads."""
ONE_LINK = "(rx: (worker_threads: 1))"
"""A client has one link; each message would wake a second thread for nothing."""
MANY_LINKS = "(rx: (worker_threads: 16))"
"""For a router: more threads than a machine has links.

When a link dies silently (cable, switch, radio), its lease expires and a receiving thread closes
it; close(2) then blocks up to 10 s for unacknowledged bytes. With Zenoh's default of two threads,
two dead links block all others.
"""

_one_at_a_time = threading.Lock()
_read = False
_opened_by = set[int]()
"""Processes that opened a session: at most this one and those it was forked by."""


@contextmanager
def receiving_threads(runtime: str) -> Iterator[None]:
    """Set Zenoh's number of receiving threads for a session that is opened in this context.

    The first session of a process decides for all, because Zenoh reads the environment variable
    only then. The variable is removed again because child processes inherit it: a router started by
    a client would have one thread. A value that the environment already has is kept.
    """
    global _read  # noqa: PLW0603 - Zenoh reads once for the whole process, too
    if _read or VARIABLE in os.environ:
        yield
        return
    with _one_at_a_time:
        os.environ[VARIABLE] = runtime
        try:
            yield
        finally:
            del os.environ[VARIABLE]
            _read = True


def open_session(
    settings: ZenohSettings, robot: RobotSettings, stop: StopFlag, wait_s: float | None
) -> zenoh.Session:
    """Open this process's session, as a client of the router, to be closed by ``with``.

    An open session survives the loss of its router: it reconnects and declares everything again.
    Close it, because an open session hangs the interpreter at exit. Fork before opening a session.

    It waits for a router for `wait_s` [s]; None: without end, as for services.

    Raises:
        UnreachableError: no router answered in `wait_s`.
        SettingsError: the endpoint or the robot's name is invalid.
        StoppedError: `stop` was set before there was a router.
    """
    refuse_forked()
    _opened_by.add(os.getpid())
    configuration = client_configuration(settings, robot)
    started_s = time.monotonic()
    deadline_s = started_s + wait_s if wait_s is not None else float("inf")
    logged = ""
    while True:
        stop.check()
        left_ms = (deadline_s - time.monotonic()) * 1000.0
        configuration["connect"]["timeout_ms"] = int(max(1.0, min(CONNECT_TRY_MS, left_ms)))
        config = as_zenoh(configuration)
        try:
            with receiving_threads(ONE_LINK):
                return zenoh.open(config)
        except zenoh.ZError as error:
            refused = refusal(settings)
            if time.monotonic() >= deadline_s:
                raise UnreachableError(
                    peer="router",
                    endpoint=settings.router,
                    waited_s=time.monotonic() - started_s,
                    problem=refused
                    or f"no router at {settings.router} within {wait_s:g} s: start one with "
                    f"'clustermcl up' or 'clustermcl router', or set zenoh.router",
                ) from error
            if (problem := refused or f"waiting for a router at {settings.router}") != logged:
                _log.info("%s", problem)
            logged = problem
        stop.wait(min(_PAUSE_S, max(0.0, deadline_s - time.monotonic())))


def refuse_forked() -> None:
    """Raise RuntimeError in a process forked by one that opened a session: Zenoh would hang."""
    if _opened_by - {os.getpid()}:
        raise RuntimeError("forked by a process that had connected: use multiprocessing's 'spawn'")


def refusal(settings: ZenohSettings) -> str | None:
    """Return why the router refuses us; Zenoh raises the same ZError for an absent router."""
    if not settings.router.startswith(("tls/", "tcp/")):
        return None
    from clustermcl.link.tls import requires_tls, why_refused  # noqa: PLC0415 - import takes 10 ms

    refused = None
    if settings.router.startswith("tls/"):
        refused = why_refused(settings)
    elif requires_tls(settings.router):
        refused = "the router there has TLS: set zenoh.router = tls/... and a certificate"
    return f"{settings.router}: {refused}" if refused else None
