import logging
import os
import subprocess
import sys
from collections.abc import Iterator

import pytest
from typer.testing import CliRunner

from clustermcl.commands.command import app
from clustermcl.commands.verbosity import is_verbose, log_settings
from clustermcl.runtime.logs import configure_logging, is_quiet
from clustermcl.runtime.settings import Settings


@pytest.fixture(autouse=True)
def usual_logging() -> Iterator[None]:
    """Handlers of pytest's own come back as they were."""
    root = logging.getLogger()
    handlers, level = root.handlers[:], root.level
    root.handlers = []
    configure_logging("clustermcl", "warning")
    yield
    root.handlers = handlers
    root.setLevel(level)


@pytest.fixture
def settings_seen(monkeypatch: pytest.MonkeyPatch) -> list[Settings]:
    settings: list[Settings] = []

    def checked(given: Settings) -> None:
        settings.append(given)
        raise SystemExit

    monkeypatch.setattr("clustermcl.commands.up._check_in_child", checked)
    return settings


@pytest.mark.parametrize("words", [["--quiet", "up"], ["-q", "up"]])
def test_quiet_before_the_command_reaches_the_processes(
    words: list[str], settings_seen: list[Settings]
) -> None:
    assert CliRunner().invoke(app, words).exit_code == 0
    assert is_quiet()
    assert settings_seen[0].log.level == "error"


def test_verbose_makes_processes_log_everything_unless_a_setting_differs(
    settings_seen: list[Settings],
) -> None:
    CliRunner().invoke(app, ["-v", "up"])
    CliRunner().invoke(app, ["-v", "up", "--set", "log.level=warning"])
    assert is_verbose()
    assert [settings.log.level for settings in settings_seen] == ["debug", "warning"]


def test_without_either_option_the_settings_decide(settings_seen: list[Settings]) -> None:
    CliRunner().invoke(app, ["up"])
    assert not is_quiet()
    assert not is_verbose()
    assert log_settings() == []
    assert settings_seen[0].log.level == Settings().log.level


def completed(*words: str) -> list[str]:
    """What bash offers for the last of the words."""
    return subprocess.run(
        [
            sys.executable,
            "-c",
            "from clustermcl.commands.command import app; app(prog_name='clustermcl')",
        ],
        env={
            **os.environ,
            "_CLUSTERMCL_COMPLETE": "complete_bash",
            "COMP_WORDS": " ".join(["clustermcl", *words]),
            "COMP_CWORD": str(len(words)),
        },
        capture_output=True, text=True, timeout=60, check=True,
    ).stdout.split()  # fmt: skip


def test_a_shell_offers_commands() -> None:
    assert completed("hyp") == ["hypotheses"]
