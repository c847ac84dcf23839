import json
import subprocess
import sys
from pathlib import Path

import pytest

from clustermcl.commands.options import print_answer

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


@pytest.mark.parametrize("words", ["settings", "--help", "pose --help", ".link.secure_router"])
def test_a_full_disk_is_one_line_and_exit_code_2(words: str) -> None:
    command = ["clustermcl" + words] if words[0] == "." else ["clustermcl", *words.split()]
    name = command[0].rpartition(".")[2]
    message = f"{name}: standard output: cannot be written: No space left on device\n"
    assert typed(*command) == (2, message)


def test_control_characters_of_a_peer_never_reach_the_terminal(
    capsys: pytest.CaptureFixture[str],
) -> None:
    name = "tag\x1b[2J\x9b1m\r\n\u202e\U000e0001"
    print_answer([f"landmark {name}", "next"])
    line, following = capsys.readouterr().out.splitlines()
    assert (line, following) == (f"landmark {json.dumps(name)[1:-1]}", "next")
    print_answer({"landmark": name})
    printed = capsys.readouterr().out
    assert printed.rstrip("\n").isprintable()
    assert json.loads(printed) == {"landmark": name}
