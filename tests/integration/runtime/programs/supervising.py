"""A supervisor over the commands given as JSON: a list of [name, command]."""

import json
import sys
import time

from clustermcl.runtime.main import Invocation, process_main
from clustermcl.runtime.supervisor import ChildSpec, Supervisor


def body(invocation: Invocation) -> None:
    supervisor = Supervisor()
    for name, command in json.loads(sys.argv[-1]):
        supervisor.add(ChildSpec(name, command))
    while not invocation.stop.wait(0.02):
        supervisor.poll(time.monotonic())
    supervisor.stop()


if __name__ == "__main__":
    process_main(
        "supervising",
        body,
        describe="Test supervisor.",
        add_arguments=lambda parser: parser.add_argument("children"),
    )
