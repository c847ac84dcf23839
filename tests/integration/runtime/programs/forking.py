"""A parent that has imported numpy and forks children, each with a Zenoh session of its own."""

import argparse
import os

import zenoh

from clustermcl.link.session import open_session
from clustermcl.runtime import supervisor
from clustermcl.runtime.main import Invocation, process_main
from clustermcl.runtime.stop import StopFlag


def body(invocation: Invocation) -> None:
    """Fork; every child answers the query ``child/INDEX`` with its process id.

    A query with a payload gives it that many jobs.
    """
    supervisor.use_one_thread_for_arithmetic()
    import numpy as np  # noqa: PLC0415 - only now it starts no threads

    squares = np.arange(4.0) ** 2
    settings = invocation.settings

    def child_main(index: int, stop: StopFlag, report_jobs: supervisor.ReportJobs) -> None:
        jobs: list[int] = []

        def on_query(query: zenoh.Query) -> None:
            if query.payload is not None:
                jobs.append(int(query.payload.to_string()))
            query.reply(f"child/{index}", answer)

        answer = f"{os.getpid()} {os.getppid()} {squares.sum():g}"
        with (
            open_session(settings.zenoh, settings.robot, stop, wait_s=None) as session,
            session.declare_queryable(f"child/{index}", on_query),
        ):
            print(f"child {index} is {os.getpid()}", flush=True)
            while not stop.wait(0.1):
                while jobs:
                    report_jobs(jobs.pop(0))

    arguments = invocation.arguments
    supervisor.run_forked(
        supervisor.ChildCount(arguments.count, max(arguments.count, arguments.most), 0.5),
        child_main,
        invocation.stop,
        name=invocation.process,
        hung_after_s=arguments.hung_after,
    )


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """How many children, and when one hangs [s]."""
    parser.add_argument("--count", type=int, default=3)
    parser.add_argument("--most", type=int, default=0)
    parser.add_argument("--hung-after", type=float, default=60.0)


if __name__ == "__main__":
    process_main("forking", body, describe="Test parent.", add_arguments=add_arguments)
