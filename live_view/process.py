"""The page's process: hears one robot's system, keeps the picture, serves it."""

import argparse
import logging
import secrets
import webbrowser
from collections.abc import Callable

from live_view.admission import DEFAULT_PORT, Address, parsed_address
from live_view.live_loop import LiveLoop, new_inbox
from live_view.page_server import PageServer
from process_runtime.main import Invocation, process_main
from process_runtime.settings import Settings
from process_runtime.stop import StopFlag

_log = logging.getLogger(__name__)


def main() -> None:
    """Serve the page."""
    process_main(
        "live_view",
        run_live_view,
        describe="A page in the browser that draws the clusters as they are.",
        add_arguments=_add_arguments,
    )


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    listen = f"127.0.0.1:{DEFAULT_PORT}"
    parser.add_argument("--listen", default=listen, help=f"HOST:PORT (default: {listen})")
    parser.add_argument("--allow-commands", action="store_true", help="buttons also from elsewhere")
    parser.add_argument("--open", action="store_true", help="open the page in a browser")


def run_live_view(invocation: Invocation) -> None:
    """Serve the page until told to stop; as a process of its own.

    Raises:
        SettingsError: the address cannot be used.
    """
    arguments = invocation.arguments
    serve_page(
        invocation.settings,
        invocation.stop,
        parsed_address(arguments.listen),
        say=lambda link: _log.info("look at %s", link),
        allow_commands=arguments.allow_commands,
        open_browser=arguments.open,
    )


def serve_page(
    settings: Settings,
    stop: StopFlag,
    address: Address,
    *,
    say: Callable[[str], None],
    allow_commands: bool,
    open_browser: bool,
) -> None:
    """Serve the page until `stop` is set; without a running system it waits for one.

    Args:
        settings: the router's endpoint and the robot's name.
        stop: looked at every 0.1 s.
        address: where; away from loopback the link holds a token.
        say: told the link once it can be opened.
        allow_commands: obey buttons away from loopback too.
        open_browser: open the page.

    Raises:
        SettingsError: the address cannot be used.
    """
    commands = allow_commands or address.is_loopback
    token = "" if address.is_loopback else secrets.token_urlsafe(18)
    inbox = new_inbox()
    with PageServer(address, token, inbox.put, commands=commands) as server:
        say(server.link)
        if open_browser:
            webbrowser.open(server.link)
        LiveLoop(settings, inbox, server, commands=commands).run(stop)
