"""The command as a person types it, in a process of its own."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil

from tests.integration.waiting import PATIENCE_S, wait_until

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


class TypedCommand:
    """A running command with all its child processes."""

    def __init__(
        self, words: tuple[str, ...], folder: Path, environment: dict[str, str], module: str
    ) -> None:
        self._out, self._err = folder / "out.txt", folder / "err.txt"
        with self._out.open("wb") as out, self._err.open("wb") as err:
            self.popen = subprocess.Popen(
                [sys.executable, "-I", "-m", module, *words],
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=err,
                env=environment,
                start_new_session=True,
            )
        self.family: set[psutil.Process] = set()

    @property
    def out(self) -> str:
        return self._out.read_text()

    @property
    def err(self) -> str:
        return self._err.read_text()

    def meet_family(self) -> list[psutil.Process]:
        """The direct children; all descendants are remembered."""
        parent = psutil.Process(self.popen.pid)
        self.family.update(parent.children(recursive=True))
        return parent.children()

    def wait_for(self, text: str, deadline_s: float = PATIENCE_S) -> None:
        wait_until(lambda: text in self.out or text in self.err, deadline_s)
        self.meet_family()

    def end(self, number: int) -> int:
        self.meet_family()
        self.popen.send_signal(number)
        return self.popen.wait(PATIENCE_S)

    def assert_nothing_runs(self) -> None:
        assert self.family, "there were processes to look for"
        _, alive = psutil.wait_procs(self.family, timeout=PATIENCE_S)
        assert alive == []


@contextmanager
def typed(
    *words: str, folder: Path, environment: dict[str, str], module: str = "clustermcl"
) -> Iterator[TypedCommand]:
    """Start a command; whatever of it still runs at the end is killed."""
    command = TypedCommand(words, folder, environment, module)
    try:
        yield command
    finally:
        command.popen.kill()
        command.popen.wait()
        for process in command.family:
            if process.is_running():
                process.kill()
