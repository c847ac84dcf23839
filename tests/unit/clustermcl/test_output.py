import subprocess
import sys
from pathlib import Path

import pytest

FULL = Path("/dev/full")
pytestmark = pytest.mark.skipif(not FULL.exists(), reason="needs Linux's full disk")


def typed(module: str, *words: str) -> tuple[int, str]:
    """Exit code and standard error of a command whose output goes to a full disk."""
    with FULL.open("wb") as disk:
        ran = subprocess.run(
            [sys.executable, "-I", "-m", module, *words],
            stdin=subprocess.DEVNULL, stdout=disk, stderr=subprocess.PIPE, text=True, check=False,
        )  # fmt: skip
    return ran.returncode, ran.stderr


@pytest.mark.parametrize("words", [["settings"], ["--help"], ["pose", "--help"]], ids=" ".join)
def test_a_full_disk_is_one_line_and_exit_code_2(words: list[str]) -> None:
    message = "clustermcl: standard output: cannot be written: No space left on device\n"
    assert typed("clustermcl", *words) == (2, message)


def test_a_full_disk_for_the_routers_file_is_one_line_and_exit_code_2() -> None:
    message = "secure_router: standard output: cannot be written: No space left on device\n"
    assert typed("clustermcl.link.secure_router") == (2, message)
