"""The demo: everything on this machine, on a recording or a simulated robot, until its end."""

import http.client
import socket
import time
from collections.abc import Callable
from contextlib import closing, suppress
from pathlib import Path

from rich.console import Console

from clustermcl.as_json import dumped
from clustermcl.demo_audience import Audience
from clustermcl.demo_result import Result, as_object, summary_lines
from clustermcl.demo_show import DemoOptions, Show, prepared
from clustermcl.demo_view import LineView, LiveView, NoView, View
from clustermcl.record import recorded
from clustermcl.stack import Stack, meeting_in, running, temporary_folder
from clustermcl.verbosity import is_verbose
from clustermcl.view import say_link
from live_view.admission import Address, parsed_address
from process_runtime.logs import is_quiet
from process_runtime.output import standard_output
from process_runtime.output_files import check_output_file
from process_runtime.settings import Settings
from process_runtime.stop import StopFlag, stop_on_signals
from protocol import keys
from protocol.answers import Status
from protocol.errors import SettingsError, UnreachableError
from zenoh_link.session import open_session
from zenoh_link.wire import ask

_CONNECT_WITHIN_S = 20.0
_POLL_S = 0.05


def run_demo(options: DemoOptions, settings: Settings) -> None:
    """Run a demo to its end and print the result.

    Raises:
        ClusterMclError: an input cannot be used, or a process failed.
        StoppedError: interrupted.
    """
    started_s = time.monotonic()
    if options.record is not None:
        check_output_file(options.record)
    page = None if options.view_at is None else _page_at(options.view_at)
    if page is None and options.by_hand:
        problem = "--drive: the robot is driven on the page: give --view, too"
        raise SettingsError(key="--drive", problem=problem)
    stop = stop_on_signals(exit_after_s=5.0)
    show = prepared(options, settings)
    view = _view(options, show)
    with temporary_folder() as folder:
        arguments = ["--steps", str(show.steps)] if show.simulated else []
        arguments += ["--map", options.map_file] if show.simulated and options.map_file else []
        arguments += ["--by-hand"] if options.by_hand else []
        met = meeting_in(folder, show.settings)
        stack = Stack(
            met,
            folder,
            logs_in_folder=not is_verbose(),
            simulator_arguments=arguments,
            page_arguments=_page_arguments(options),
        )
        with running(stack):
            result = _run(stack, met, show, view, stop, options.record, page)
            wall_s = time.monotonic() - started_s
            if options.as_json:
                _print(dumped(as_object(result, wall_s)))
            else:
                _print("\n".join(summary_lines(result, wall_s)))
            while page is not None:  # the run can be looked back at, until Ctrl-C
                stop.check()
                stack.check()
                time.sleep(_POLL_S)


def _page_arguments(options: DemoOptions) -> list[str] | None:
    if options.view_at is None:
        return None
    by_hand = ["--by-hand"] if options.by_hand else []
    return ["--listen", options.view_at, "--story", *by_hand]


def _page_at(view_at: str) -> Address:
    """Where a person is going to look.

    Raises:
        SettingsError: others would reach it: that wants a token, as of `clustermcl view`.
    """
    address = parsed_address(view_at)
    if not address.is_loopback or not address.port:
        problem = "--listen: a demo is shown on this machine alone, at a port that is named"
        raise SettingsError(key="--listen", problem=problem)
    return address


def _say_where(page: Address, check: Callable[[], None]) -> None:
    """Print the link once the page is served."""
    while True:
        check()
        try:
            socket.create_connection((page.host, page.port), timeout=_POLL_S).close()
        except OSError:
            time.sleep(_POLL_S)
        else:
            say_link(f"http://{page.netloc}/")
            return


def _wait_for_browser(page: Address, check: Callable[[], None]) -> None:
    """Wait until the page is open: the first search is the best of the story."""
    while True:
        check()
        connection = http.client.HTTPConnection(page.host, page.port, timeout=1.0)
        with closing(connection), suppress(OSError):
            connection.request("GET", "/browsers")
            if connection.getresponse().read() != b"0":
                return
        time.sleep(_POLL_S)


def _view(options: DemoOptions, show: Show) -> View:
    console = Console(stderr=options.as_json, emoji=False)
    steps = None if show.ends_when_localized else show.steps
    if is_quiet():
        return NoView()
    if console.is_terminal:
        return LiveView(console, show.title, steps)
    return NoView() if options.as_json else LineView(console, show.title)


def _run(
    stack: Stack,
    settings: Settings,
    show: Show,
    view: View,
    stop: StopFlag,
    record: Path | None,
    page: Address | None,
) -> Result:
    def check() -> None:
        stop.check()
        stack.check()

    stack.start_without_coordinator()
    try:
        if page is not None:
            _say_where(page, check)
        with (
            open_session(settings.zenoh, settings.robot, stop, wait_s=_CONNECT_WITHIN_S) as session,
            recorded(session, record),
            view,
        ):
            audience = Audience(session, show, view, check)
            audience.wait_for_workers(settings.worker.count)
            if page is not None:
                _wait_for_browser(page, check)
            stack.start_coordinator()
            summary = audience.follow()
            belief = summary.belief
            assert belief is not None  # the summary ends with one
            truth = audience.truth_of(belief)
            status = ask(session, keys.STATUS, Status, timeout_s=settings.zenoh.query_timeout_s)
            return Result(summary, belief, truth, status)
    except UnreachableError:
        stack.check()  # whose last words say why
        raise


def _print(text: str) -> None:
    output = standard_output()
    output.write(text + "\n")
    output.flush()
