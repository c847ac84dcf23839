import logging
from collections.abc import Iterator

import pytest
from typer.testing import CliRunner

from clustermcl.commands.command import app
from clustermcl.commands.verbosity import is_verbose
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


def test_options_before_the_command_reach_the_processes_unless_a_setting_differs(
    settings_seen: list[Settings],
) -> None:
    for words in (["up"], ["--quiet", "up"], ["-q", "up"], ["-v", "up"], ["up"]):
        configure_logging("clustermcl", "warning")
        assert CliRunner().invoke(app, words).exit_code == 0
        assert (is_quiet(), is_verbose()) == (words[0] in ("--quiet", "-q"), words[0] == "-v")
    CliRunner().invoke(app, ["-v", "up", "--set", "log.level=warning"])
    usual = Settings().log.level
    seen = [settings.log.level for settings in settings_seen]
    assert seen == [usual, "error", "error", "debug", usual, "warning"]


def test_a_shell_offers_commands() -> None:
    words = {"COMP_WORDS": "clustermcl hyp", "COMP_CWORD": "1"}
    asked = {"_CLUSTERMCL_COMPLETE": "complete_bash", **words}
    found = CliRunner().invoke(app, env=asked, prog_name="clustermcl")
    assert found.output.split() == ["hypotheses"]
