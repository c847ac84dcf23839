"""The process of a robot's page."""

import argparse

from clustermcl.runtime.main import Invocation, process_main
from clustermcl.view.admission import DEFAULT_PORT, parsed_address
from clustermcl.view.live_loop import LiveLoop


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    add, listen = parser.add_argument, f"127.0.0.1:{DEFAULT_PORT}"
    add("--listen", default=listen, help=f"HOST:PORT (default: {listen})")
    add("--allow-commands", action="store_true", help="allow commands from other machines too")
    add("--story", default="", metavar="WORLD", help="show the captions of this world")


def run_live_view(invocation: Invocation) -> None:
    """Serve the page until the process is stopped, also while no system is running."""
    settings, arguments = invocation.settings, invocation.arguments
    address = parsed_address(arguments.listen)
    about = {
        "commands": arguments.allow_commands or address.is_loopback,
        "radius_m": settings.robot.radius_m,
        "story": arguments.story,
    }
    LiveLoop(settings, address, about, invocation.stop).run(invocation.stop)


if __name__ == "__main__":
    about = "Serve a page that shows where the robot may be."
    process_main("view", run_live_view, describe=about, add_arguments=_add_arguments)
