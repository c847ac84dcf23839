"""Sessions that receive everything on ``test``, as the workers of a machine receive scans."""

import argparse
from contextlib import ExitStack

from clustermcl.link.session import open_session
from clustermcl.runtime.main import Invocation, process_main


def body(invocation: Invocation) -> None:
    settings = invocation.settings
    with ExitStack() as sessions:
        for _ in range(invocation.arguments.count):
            session = sessions.enter_context(
                open_session(settings.zenoh, settings.robot, invocation.stop, wait_s=90.0)
            )
            session.declare_subscriber("test", lambda _sample: None)
        print("all listen", flush=True)
        invocation.stop.wait(float("inf"))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--count", type=int, required=True)


if __name__ == "__main__":
    process_main("listeners", body, describe="Listeners.", add_arguments=add_arguments)
