"""Several parts of one process, each in a thread of its own."""

import logging
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from functools import partial

from clustermcl.protocol.errors import ClusterMclError
from clustermcl.runtime.stop import StopFlag, StoppedError
from clustermcl.runtime.supervisor import Backoff

_POLL_S = 0.2
_LOG_AGAIN_S = 60.0

_log = logging.getLogger(__name__)


@contextmanager
def disk_thread(
    work: Callable[[], object], name: str, end: Callable[[], object], within_s: float
) -> Iterator[None]:
    """Run a thread that writes to a disk within the ``with`` block; `end` asks it to end.

    Its last write may take this time, as a process has 1.5 s to end, see `Supervisor.stop`.
    """
    thread = threading.Thread(target=work, name=name, daemon=True)
    thread.start()
    try:
        yield
    finally:
        end()
        thread.join(within_s)
        if thread.is_alive():
            _log.warning("slow disk: the last data of the %s may be lost", name)


def run_in_threads(
    parts: Sequence[Callable[[StopFlag], object]],
    stop: StopFlag,
    on_turn: Callable[[], object] = lambda: None,
) -> None:
    """Run each part in a thread until the process is stopped or a part ends, and raise its error.

    Each part has a stop flag of its own. While one does not check it, the process gives no sign of
    life, so that its supervisor restarts it. `on_turn` is called several times a second.
    """
    flags, checked = [StopFlag() for _ in parts], set[StopFlag]()
    for flag in flags:
        flag.on_look = partial(checked.add, flag)
    give_sign, stop.on_look = stop.on_look, lambda: None
    with ThreadPoolExecutor(len(parts)) as pool:
        running = [pool.submit(part, flag) for part, flag in zip(parts, flags, strict=True)]
        try:
            while not stop.wait(_POLL_S) and not any(part.done() for part in running):
                on_turn()
                if len(checked) == len(flags):
                    give_sign()
                    checked.clear()
        finally:
            for flag in flags:
                flag.set()
    for part in running:
        with suppress(StoppedError):
            part.result()


def restarted(
    part: Callable[[StopFlag], object], name: str, logged: str = ""
) -> Callable[[StopFlag], None]:
    """Return a part for `run_in_threads` that begins again, ever later, when an error ends it.

    The error is logged, unless it is `logged` already, or comes again within a minute.
    """

    def run(stop: StopFlag) -> None:
        backoff, known = Backoff(), logged
        while not stop.is_set():
            began_s = time.monotonic()
            try:
                part(stop)
            except StoppedError:
                return
            except Exception as error:  # noqa: BLE001 - the outermost loop of one robot's work
                problem, lived_s = str(error), time.monotonic() - began_s
                if problem != known or lived_s > _LOG_AGAIN_S:
                    bug = None if isinstance(error, ClusterMclError) else error
                    _log.warning("%s is tried again: %s", name, problem, exc_info=bug)
                known = problem
                stop.wait(backoff.after_death(lived_s))

    return run
