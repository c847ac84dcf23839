"""The process of the page, which shows one or several robots."""

import argparse

from clustermcl.runtime.main import Invocation, process_main
from clustermcl.runtime.settings_file import with_setting
from clustermcl.runtime.threads import run_in_threads
from clustermcl.view.admission import DEFAULT_PORT, parsed_address
from clustermcl.view.live_loop import LiveLoop
from clustermcl.view.page_server import PageServer


def main() -> None:
    process_main(
        "view",
        run_live_view,
        describe="Serve a page that shows where the robot may be.",
        add_arguments=_add_arguments,
    )


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    add, listen = parser.add_argument, f"127.0.0.1:{DEFAULT_PORT}"
    add("--listen", default=listen, help=f"HOST:PORT (default: {listen})")
    add("--allow-commands", action="store_true", help="allow commands from other machines too")
    add("--open", action="store_true", help="open the page in a browser")
    add("--by-hand", action="store_true", help="begin with driving by the arrow keys")
    add("--story", default="", metavar="WORLD", help="show the captions of this world")
    add("--robot", action="append", default=[], metavar="NAME", help="robot.name; may be repeated")


def run_live_view(invocation: Invocation) -> None:
    """Serve the page until the process is stopped, also while no system is running."""
    settings, arguments = invocation.settings, invocation.arguments
    address = parsed_address(arguments.listen)
    commands = arguments.allow_commands or address.is_loopback
    names = list(dict.fromkeys(arguments.robot)) or [settings.robot.name]
    about = {
        "commands": commands,
        "by_hand": arguments.by_hand,
        "radius_m": settings.robot.radius_m,
        "story": arguments.story,
        "robots": names if len(names) > 1 else [],
    }
    loops = [
        LiveLoop(with_setting(settings, "robot.name", name, "--robot"), about, invocation.stop)
        for name in names
    ]
    rooms = [loop.room for loop in loops]
    with PageServer(address, rooms, obeys_commands=commands, open_browser=arguments.open):
        run_in_threads([loop.run for loop in loops], invocation.stop)
