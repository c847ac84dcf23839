import os
import signal
import sys
from functools import partial
from pathlib import Path

import psutil
import zenoh

from clustermcl.runtime.settings import ZenohSettings
from tests.integration.conftest import OpenClient, StartProcess
from tests.integration.processes import python_script
from tests.integration.waiting import wait_until

FORKING = Path(__file__).parent / "programs" / "forking.py"


def ask(session: zenoh.Session, index: int, timeout_s: float = 5.0) -> list[str]:
    """Answer of a child: its process id, its parent's, a sum made by numpy; [] without one."""
    for reply in session.get(f"child/{index}", timeout=timeout_s):
        if reply.ok is not None:
            return reply.ok.payload.to_string().split()
    return []


def test_forked_children_have_own_sessions_and_killed_or_hung_ones_are_replaced(
    router: ZenohSettings, start_process: StartProcess, open_client: OpenClient
) -> None:
    endpoint = f"zenoh.router={router.router}"
    process = start_process(python_script(FORKING, "--set", endpoint, "--hung-after", "3"))
    session = open_client()
    for index in range(3):
        wait_until(partial(ask, session, index))
    first = [ask(session, index) for index in range(3)]
    assert len({pid for pid, _, _ in first}) == 3
    assert {parent for _, parent, _ in first} == {str(process.pid)}
    assert {total for _, _, total in first} == {"14"}, "the parent's imports"
    children = psutil.Process(process.pid).children

    for number, message in (
        (signal.SIGKILL, "ended with code -9"),
        (signal.SIGSTOP, "hung for 3 s"),
    ):
        before = ask(session, 1)
        os.kill(int(before[0]), number)
        wait_until(lambda: ask(session, 1) not in ([], before))  # noqa: B023 - as it is now
        assert f"forking-1 {message}" in process.err
        assert [ask(session, index) for index in (0, 2)] == [first[0], first[2]]
        assert len(children()) == 3
    assert process.err.count("killed") == 1


def test_children_start_with_more_jobs_and_idle_ones_end_later(
    router: ZenohSettings, start_process: StartProcess, open_client: OpenClient
) -> None:
    endpoint = f"zenoh.router={router.router}"
    start_process(python_script(FORKING, "--set", endpoint, "--count", "2", "--most", "4"))
    session = open_client()
    for index in range(2):
        wait_until(partial(ask, session, index))
    session.get("child/0", payload="3")
    session.get("child/1", payload="2")
    wait_until(partial(ask, session, 3))
    first = [ask(session, index) for index in range(4)]
    session.get("child/3", payload="1")
    session.get("child/2", payload="0")
    for index in range(2):
        session.get(f"child/{index}", payload="1")
    wait_until(lambda: not ask(session, 2, timeout_s=1.0))
    assert [ask(session, index) for index in (0, 1, 3)] == [first[0], first[1], first[3]]


def test_a_fork_with_other_threads_running_is_refused(start_process: StartProcess) -> None:
    program = (
        "import threading; from clustermcl.runtime.supervisor import ChildCount, run_forked;"
        "from clustermcl.runtime.stop import StopFlag;"
        "threading.Thread(target=threading.Event().wait, daemon=True).start();"
        "run_forked(ChildCount(1, 1), print, StopFlag(), name='x')"
    )
    process = start_process([sys.executable, "-I", "-c", program])
    assert process.wait() == 1
    assert "RuntimeError: 2 threads run at the fork" in process.err
