"""Programs of the tests, each in an interpreter of its own."""

import subprocess
import sys


def ran(
    program: str, *arguments: str, check: bool = True, timeout_s: float = 30.0
) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-I", "-c", program, *arguments],
        capture_output=True,
        text=True,
        timeout=timeout_s,
        check=check,
    )
