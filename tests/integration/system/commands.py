"""The command as a person types it, in a process of its own."""

import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import psutil

from clustermcl.runtime.supervisor import python_module
from tests.integration.processes import RunningProcess
from tests.integration.waiting import PATIENCE_S

COMMAND = [sys.executable, "-I", "-m", "clustermcl"]
SMALL_FILTER = [
    word
    for setting in ("cluster.particles=300", "search.poses=4000", "belief.max_clusters=6")
    for word in ("--set", setting)
]
"""A filter small enough for tests."""


def ran(
    *words: str, environment: dict[str, str] | None = None, timeout_s: float = PATIENCE_S
) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*COMMAND, *words],
        env=environment, capture_output=True, text=True, timeout=timeout_s, check=False,
    )  # fmt: skip


class TypedCommand(RunningProcess):
    def __init__(
        self, command: Sequence[str], folder: Path, environment: dict[str, str] | None
    ) -> None:
        super().__init__(command, folder, "typed", env=environment, start_new_session=True)
        self.family: set[psutil.Process] = set()

    def meet_family(self) -> list[psutil.Process]:
        """The direct children; all descendants are remembered."""
        parent = psutil.Process(self.pid)
        self.family.update(parent.children(recursive=True))
        return parent.children()

    def wait_for(self, text: str, deadline_s: float = PATIENCE_S) -> None:
        super().wait_for(text, deadline_s)
        self.meet_family()

    def end(self, number: int) -> int:
        self.meet_family()
        self.send_signal(number)
        return self.wait()

    def assert_nothing_runs(self) -> None:
        assert self.family, "there were processes to look for"
        _, alive = psutil.wait_procs(self.family, timeout=PATIENCE_S)
        assert alive == []


@contextmanager
def typed(
    *words: str, folder: Path, environment: dict[str, str] | None = None, module: str = "clustermcl"
) -> Iterator[TypedCommand]:
    """Start a command; whatever of it still runs at the end is killed."""
    command = TypedCommand(python_module(module, *words), folder, environment)
    try:
        yield command
    finally:
        command.kill()
        for process in command.family:
            if process.is_running():
                process.kill()
