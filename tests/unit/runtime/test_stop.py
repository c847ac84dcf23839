import threading
import time

import pytest

from clustermcl.runtime.stop import StopFlag, StoppedError
from tests.unit.programs import ran

PRINTS_WHEN_STOPPED = """
import os, signal
from clustermcl.runtime.stop import stop_on_signals
stop = stop_on_signals()
for number in (signal.SIGTERM, signal.SIGINT, signal.SIGTERM):
    os.kill(os.getpid(), number)
print(stop.wait(60.0))
"""

CLOSED_TERMINAL = """
import os, signal, sys
from clustermcl.runtime.stop import stop_on_signals
signal.signal(signal.SIGHUP, signal.SIG_IGN if "nohup" in sys.argv else signal.SIG_DFL)
stop = stop_on_signals()
os.kill(os.getpid(), signal.SIGHUP)
print(stop.is_set())
"""

HANGS = """
import os, signal, threading
from clustermcl.runtime.stop import stop_on_signals
stop = stop_on_signals(exit_after_s=0.2)
os.kill(os.getpid(), signal.SIGTERM)
threading.Lock().acquire() and threading.Event().wait()
"""


def test_a_wait_ends_when_another_thread_sets_the_flag() -> None:
    stop = StopFlag()
    threading.Timer(0.02, stop.set).start()
    started_s = time.monotonic()
    assert stop.wait(60.0)
    assert time.monotonic() - started_s < 10.0


def test_a_wait_ends_when_the_time_is_up_and_check_raises_once_the_flag_is_set() -> None:
    stop = StopFlag()
    assert not any((stop.wait(0.0), stop.wait(0.02), stop.is_set()))
    stop.check()
    stop.set()
    with pytest.raises(StoppedError):
        stop.check()


def test_signals_set_the_flag_and_the_second_does_no_harm() -> None:
    ended = ran(PRINTS_WHEN_STOPPED)
    assert (ended.stdout, ended.stderr) == ("True\n", "")


@pytest.mark.parametrize(("how", "stops"), [("plain", "True\n"), ("nohup", "False\n")])
def test_a_terminal_that_closes_is_a_signal_to_stop_unless_it_is_ignored(
    how: str, stops: str
) -> None:
    assert ran(CLOSED_TERMINAL, how).stdout == stops


def test_a_process_that_hangs_after_the_signal_prints_its_stack_and_ends() -> None:
    ended = ran(HANGS, check=False)
    assert ended.returncode == 1
    assert "in wait" in ended.stderr
