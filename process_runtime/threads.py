"""Several parts of one process, each in a thread of its own."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial

from process_runtime.stop import StopFlag, StoppedError

_POLL_S = 0.2


def run_in_threads(
    parts: Sequence[Callable[[StopFlag], object]],
    stop: StopFlag,
    on_turn: Callable[[], object] = lambda: None,
) -> None:
    """Run each part in a thread until the process is stopped or a part ends.

    While a part does not check its stop flag, the process gives no sign of life, so that its
    supervisor restarts it.

    Args:
        parts: called with a stop flag of their own.
        stop: stop flag of the process.
        on_turn: called several times a second in this thread.

    Raises:
        Exception: the error of a part.
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
