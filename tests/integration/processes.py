"""Real processes of ours for tests: started, read, ended."""

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tests.integration.waiting import PATIENCE_S, wait_until


class RunningProcess:
    """A child process whose output goes to files, so that it never blocks and can be read."""

    def __init__(self, command: Sequence[str], folder: Path, name: str, **options: Any) -> None:
        self.out_file, self.err_file = folder / f"{name}.out", folder / f"{name}.err"
        with self.out_file.open("wb") as out, self.err_file.open("wb") as err:
            self._popen = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=out, stderr=err, **options
            )

    @property
    def pid(self) -> int:
        return self._popen.pid

    @property
    def out(self) -> str:
        return self.out_file.read_text()

    @property
    def err(self) -> str:
        return self.err_file.read_text()

    def is_running(self) -> bool:
        return self._popen.poll() is None

    def send_signal(self, number: int) -> None:
        self._popen.send_signal(number)

    def wait(self, timeout_s: float = PATIENCE_S) -> int:
        return self._popen.wait(timeout_s)

    def wait_for(self, text: str, deadline_s: float = PATIENCE_S) -> None:
        wait_until(lambda: text in self.out or text in self.err, deadline_s)

    def kill(self) -> None:
        self._popen.kill()
        self._popen.wait()


def python_script(script: Path, *arguments: str) -> list[str]:
    """Command for a program of a test, isolated like ours."""
    return [sys.executable, "-I", str(script), *arguments]
