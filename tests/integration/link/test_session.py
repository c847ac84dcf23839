import signal
import time
from collections.abc import Callable
from pathlib import Path

import pytest
import zenoh

from clustermcl.link.inbox import Inbox
from clustermcl.link.session import open_session
from clustermcl.link.wire import Asked, Event, Events, Link, Unread, ask, serve, watch_link
from clustermcl.protocol import keys
from clustermcl.protocol.answers import CommandDone
from clustermcl.protocol.errors import UnreachableError
from clustermcl.protocol.steps import Scan
from clustermcl.runtime.settings import RobotSettings, ZenohSettings
from clustermcl.runtime.stop import StopFlag
from tests.integration.conftest import OpenClient, StartProcess
from tests.integration.processes import RunningProcess, python_script
from tests.integration.routers import open_router
from tests.integration.running import running
from tests.integration.waiting import PATIENCE_S, answered, stretched_s, wait_until

CLIENT = Path(__file__).parent / "programs" / "client.py"


def client_command(settings: ZenohSettings) -> list[str]:
    return python_script(CLIENT, "--set", f"zenoh.router={settings.router}")


def publish(session: zenoh.Session, text: str, process: RunningProcess) -> None:
    """Publish until it arrives: messages are lost while a link is being set up."""

    def received() -> bool:
        session.put("test", text)
        return f"heard {text}" in process.out

    wait_until(received)


def test_two_clients_receive_each_others_messages_and_those_of_another_robot_do_not(
    router: ZenohSettings,
) -> None:
    received: list[tuple[str, str]] = []
    stop = StopFlag()
    with (
        open_session(router, RobotSettings(name="a"), stop, PATIENCE_S) as a,
        open_session(router, RobotSettings(name="b"), stop, PATIENCE_S) as b,
        a.declare_subscriber("test", lambda s: received.append(("a", s.payload.to_string()))),
        b.declare_subscriber("test", lambda s: received.append(("b", s.payload.to_string()))),
    ):
        a.put("test", "to a")
        b.put("test", "to b")
        wait_until(lambda: len(received) >= 2)
    assert sorted(received) == [("a", "to a"), ("b", "to b")]


def test_a_command_without_a_router_reports_this_after_its_time_out(
    zenoh_settings: ZenohSettings,
) -> None:
    started_s = time.monotonic()
    with (
        pytest.raises(UnreachableError, match="no router at unixsock-stream/") as caught,
        open_session(zenoh_settings, RobotSettings(), StopFlag(), wait_s=0.3),
    ):
        pass
    assert zenoh_settings.router in str(caught.value)
    assert 0.3 <= time.monotonic() - started_s < stretched_s(3.0)


def test_a_client_waits_for_a_router_that_comes_later(
    zenoh_settings: ZenohSettings, start_process: StartProcess, open_client: OpenClient
) -> None:
    process = start_process(client_command(zenoh_settings))
    process.wait_for("waiting for a router at")
    with open_router(zenoh_settings):
        process.wait_for("subscribed")
        publish(open_client(), "hello", process)
        started_s = time.monotonic()
        process.send_signal(signal.SIGTERM)
        assert (process.wait(), process.err.count("\n")) == (0, 1)
    assert process.out.endswith("closed\n")
    assert time.monotonic() - started_s < stretched_s(2.0)


def test_a_session_reconnects_to_its_router_repeats_its_declarations_and_reports_both(
    zenoh_settings: ZenohSettings,
    start_router: Callable[[], RunningProcess],
    start_process: StartProcess,
    open_client: OpenClient,
) -> None:
    first_router = start_router()
    process = start_process(client_command(zenoh_settings))
    session, inbox = open_client(), Inbox[Event]({})
    watch_link(session, inbox)
    publish(session, "before", process)
    assert inbox.get(PATIENCE_S) == Link(up=True)
    first_router.send_signal(signal.SIGKILL)
    first_router.wait()
    assert inbox.get(PATIENCE_S) == Link(up=False)
    wait_until(lambda: not session.info.routers_zid())
    start_router()
    assert inbox.get(PATIENCE_S) == Link(up=True)
    publish(session, "after", process)


@pytest.mark.usefixtures("router")
def test_unread_messages_are_kept_up_to_the_limit_and_wake_no_thread(
    open_client: OpenClient,
) -> None:
    inbox: Events = Inbox({"state": 1})
    unread = Unread(keys.SCAN, Scan, inbox, "state", count=3)
    unread.declare(open_client())
    speaker, received, rounds = open_client(), list[bytes](), list[int]()

    def reads_the_last() -> bool:
        rounds.append(len(rounds))
        for number in range(8):
            speaker.put(keys.SCAN, bytes([rounds[-1], number]))
        time.sleep(0.1 * len(rounds))
        received[:] = unread.drain()
        return received[-1:] == [bytes([rounds[-1], 7])]

    wait_until(reads_the_last)
    assert received == [bytes([rounds[-1], number]) for number in (5, 6, 7)]
    assert list(unread.drain()) == []
    speaker.put(keys.SCAN, bytes(Scan.max_bytes + 1))
    wait_until(lambda: not list(unread.drain()) and inbox.dropped() == {"state too large": 1})
    assert inbox.get(0.0) is None


@pytest.mark.usefixtures("router")
@pytest.mark.parametrize("deaf_first", [True, False])
def test_a_process_that_never_answers_delays_no_answer_of_another(
    open_client: OpenClient, deaf_first: bool
) -> None:
    answers, unread = Inbox[Event]({}), Inbox[Event]({})
    deaf, speaks, asks = open_client(), open_client(), open_client()
    for session in (deaf, speaks) if deaf_first else (speaks, deaf):
        serve(session, keys.UPDATE, answers if session is speaks else unread)

    def answer(stop: StopFlag) -> None:
        while not stop.is_set():
            if isinstance(asked := answers.get(0.05), Asked):
                asked.answer(CommandDone(sender="speaks"))

    with running(answer):
        answered(asks, keys.UPDATE, CommandDone)  # the router knows it now
        for _ in range(5):
            assert ask(asks, keys.UPDATE, CommandDone, timeout_s=PATIENCE_S).sender == "speaks"
