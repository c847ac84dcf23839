import multiprocessing
import os
import signal
import threading

import pytest

from clustermcl.evaluation.run import RunError, in_parallel
from clustermcl.protocol.errors import MapFileError
from clustermcl.runtime.stop import StopFlag
from tests.integration.waiting import wait_until
from tests.unit.evaluation.work_pieces import work


def interrupt() -> None:
    """Send what the terminal sends to processes that have hardly started."""
    wait_until(multiprocessing.active_children)
    for child in multiprocessing.active_children():
        for number in (signal.SIGTERM, signal.SIGINT):
            os.kill(child.pid or 0, number)


def test_each_piece_is_done_once_and_signals_to_the_group_are_left_to_the_parent() -> None:
    threading.Thread(target=interrupt).start()
    done = dict(in_parallel(work, ["a", "b", "c"], 2, StopFlag()))
    assert done == {0: "A", 1: "B", 2: "C"}
    assert list(in_parallel(work, [], 4, StopFlag())) == []


def test_an_error_of_a_piece_is_raised_and_ends_the_others() -> None:
    with pytest.raises(MapFileError, match=r"^map\.yaml:7: a bad line$") as raised:
        list(in_parallel(work, ["refuse", "hang"], 2, StopFlag()))
    assert (raised.value.path.name, raised.value.line) == ("map.yaml", 7)
    wait_until(lambda: not multiprocessing.active_children())  # a thread of the pool reaps, too


def test_a_process_that_dies_is_reported() -> None:
    with pytest.raises(RunError, match="ended in the middle of a run"):
        list(in_parallel(work, ["a", "die", "hang"], 1, StopFlag()))


def test_a_stop_ends_what_hangs_and_keeps_what_is_done() -> None:
    stop, done = StopFlag(), []
    for each in in_parallel(work, ["a", "hang", "b"], 1, stop):
        done.append(each)
        stop.set()
    assert done == [(0, "A")]
    wait_until(lambda: not multiprocessing.active_children())  # a thread of the pool reaps, too
