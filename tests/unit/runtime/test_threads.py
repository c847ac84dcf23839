import threading
import time

import pytest

from clustermcl.runtime.stop import StopFlag
from clustermcl.runtime.threads import restarted, run_in_threads

PATIENCE_S = 20.0


def until_stopped(stop: StopFlag) -> None:
    while not stop.wait(0.01):
        pass
    stop.check()


def test_the_error_of_a_part_ends_the_others_and_is_raised() -> None:
    def failing(_stop: StopFlag) -> None:
        raise ValueError("no map")

    with pytest.raises(ValueError, match="no map"):
        run_in_threads([until_stopped, failing], StopFlag())


def test_no_sign_of_life_is_given_while_one_part_hangs() -> None:
    stop, signs, hangs, released = StopFlag(), list[float](), threading.Event(), threading.Event()
    stop.on_look = lambda: signs.append(time.monotonic())
    counts = list[int]()

    def hanging(own: StopFlag) -> None:
        own.wait(0.6)
        hangs.set()
        released.wait(PATIENCE_S)

    def on_turn() -> None:
        if hangs.is_set():
            counts.append(len(signs))
        if len(counts) == 6:
            stop.set()
            released.set()

    run_in_threads([until_stopped, hanging], stop, on_turn)
    assert counts[0] > 0
    assert counts[-1] <= counts[0] + 1, "what it checked before it hung may give one more"


def test_an_error_of_one_part_ends_its_turn_and_not_the_others(
    caplog: pytest.LogCaptureFixture,
) -> None:
    stop, turns = StopFlag(), list[int]()

    def failing(_stop: StopFlag) -> None:
        turns.append(1)
        if len(turns) == 4:
            stop.set()
        raise ValueError("no map")

    run_in_threads([until_stopped, restarted(failing, "robot 2")], stop)
    assert caplog.messages == ["robot 2 is tried again: no map"], "logged once, with its traceback"
    assert caplog.records[0].exc_info
