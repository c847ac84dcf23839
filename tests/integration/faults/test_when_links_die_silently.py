"""docs/failures.md: several links die without a word. Those who still have theirs are served."""

import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import zenoh

from clustermcl.link.session import open_session
from clustermcl.runtime.settings import RobotSettings, ZenohSettings
from clustermcl.runtime.stop import StopFlag
from clustermcl.runtime.supervisor import python_module
from tests.integration.conftest import StartProcess
from tests.integration.faults.two_machines import Cable, second_machine
from tests.integration.free_port import free_port
from tests.integration.processes import python_script
from tests.integration.waiting import PATIENCE_S, stretched_s, wait_until

LISTENERS = Path(__file__).parent / "programs" / "listeners.py"
LINKS = 12
CLOSING_S = 12.0
"""The lease of a dead link (2 s) plus the time that its close may block (10 s) [s]."""


@pytest.fixture
def cable() -> Iterator[Cable]:
    with second_machine() as made:
        yield made


def put_and_time_the_answer(session: zenoh.Session) -> float:
    """Publish while the links are dead; return the duration of a query [s]."""
    session.put("test", bytes(10_000))
    asked_s = time.monotonic()
    wait_until(lambda: any(reply.ok for reply in session.get("pose", timeout=1.0)))
    return time.monotonic() - asked_s


def test_a_client_with_a_link_is_answered_while_other_links_die(
    cable: Cable, start_process: StartProcess
) -> None:
    settings = ZenohSettings(router=f"tcp/{cable.here}:{free_port()}")
    words = ["--set", f"zenoh.router={settings.router}"]
    start_process(python_module("clustermcl.link.router", *words)).wait_for("router listens at")
    listeners = python_script(LISTENERS, *words, "--count", str(LINKS))
    start_process([*cable.over_there, *listeners]).wait_for("all listen")
    robot, stop = RobotSettings(), StopFlag()
    with (
        open_session(settings, robot, stop, wait_s=PATIENCE_S) as answers,
        open_session(settings, robot, stop, wait_s=PATIENCE_S) as asks,
    ):
        answers.declare_queryable("pose", lambda query: query.reply("pose", b"here"))
        put_and_time_the_answer(asks)

        with cable.cut(from_here=True, from_there=True):
            cut_s, longest_s = time.monotonic(), 0.0
            while time.monotonic() < cut_s + CLOSING_S:
                longest_s = max(longest_s, put_and_time_the_answer(asks))
                stop.wait(0.05)  # as often as a laser speaks
        assert longest_s < stretched_s(3.0)
