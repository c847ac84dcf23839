import argparse
from collections.abc import Callable
from pathlib import Path

import pytest

from clustermcl.protocol.errors import UnreachableError
from clustermcl.runtime.main import Invocation, run_process
from clustermcl.runtime.stop import StopFlag, StoppedError


def run(body: Callable[[Invocation], None], *argv: str) -> int:
    def add_arguments(parser: argparse.ArgumentParser) -> None:
        parser.add_argument("--count", type=int)

    return run_process(
        "tester", body, StopFlag(), describe="x", add_arguments=add_arguments, argv=argv
    )


def test_the_body_gets_name_settings_and_its_own_arguments(tmp_path: Path) -> None:
    file = tmp_path / "settings.toml"
    file.write_text("seed = 4\n")
    got: list[Invocation] = []
    given = ["--settings", str(file), "--set", "robot.name=r2", "--name", "t-1", "--count", "3"]
    assert run(got.append, *given) == 0
    invocation = got[0]
    assert (invocation.process, invocation.settings.seed) == ("t-1", 4)
    assert (invocation.settings.robot.name, invocation.arguments.count) == ("r2", 3)


@pytest.mark.parametrize(
    ("error", "code", "message"),
    [
        (UnreachableError(peer="router", problem="no router\nanywhere", waited_s=0.0), 2,
         "t-1: no router anywhere\n"),
        (StoppedError(), 0, ""),
    ],
    ids=["a user's mistake", "being stopped while waiting"],
)  # fmt: skip
def test_expected_ends_are_at_most_a_line_and_their_exit_code(
    error: Exception, code: int, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    def body(_: Invocation) -> None:
        raise error

    assert run(body, "--name", "t-1") == code
    assert capsys.readouterr().err == message


def test_a_bug_is_logged_with_its_traceback_and_exit_code_1(
    capsys: pytest.CaptureFixture[str],
) -> None:
    def body(_: Invocation) -> None:
        raise ZeroDivisionError("oops")

    assert run(body) == 1
    assert "Traceback" in (text := capsys.readouterr().err)
    assert text.endswith("ZeroDivisionError: oops\n")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--set", "cluster.particles=none"], "--set: cluster.particles = 'none': expected a "),
        (["--cuont", "3"], "unrecognized arguments: --cuont 3"),
    ],
)
def test_a_wrong_argument_is_one_line_before_the_body_runs(
    words: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    got: list[Invocation] = []
    try:
        code = run(got.append, *words)
    except SystemExit as ended:
        code = ended.code
    error = capsys.readouterr().err
    assert (code, got, error.count("\n")) == (2, [], 1)
    assert error.startswith(f"tester: {message}")


@pytest.mark.parametrize("name", ["", "a/b", "*", "a$*", "../a", "a.b", "@a", "x" * 57, "a\n"])
def test_a_name_that_is_invalid_in_a_key_or_file_name_is_refused(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as caught:
        run(lambda _: None, f"--name={name}")
    assert caught.value.code == 2
    assert "is not a valid name: use letters" in capsys.readouterr().err
