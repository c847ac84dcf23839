import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

from clustermcl.command import app
from evaluation.experiments.plan import UnknownExperimentError
from evaluation.experiments.recorded import DATA_VARIABLE
from protocol.errors import SettingsError


@pytest.fixture(autouse=True)
def no_recordings(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(DATA_VARIABLE, raising=False)


@pytest.fixture(autouse=True)
def own_signals() -> Iterator[None]:
    """The command takes SIGINT and SIGTERM for itself; the tests want them back."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def test_the_list_names_the_experiments_and_what_is_left_out() -> None:
    result = CliRunner().invoke(app, ["experiments", "--list"], env={"COLUMNS": "160"})
    assert result.exit_code == 0
    for name in ("cross-no-transition", "kidnap-office", "people", DATA_VARIABLE):
        assert name in result.output


@pytest.mark.parametrize(
    ("arguments", "kind", "words"),
    [
        (["crosss"], UnknownExperimentError, "did you mean cross"),
        (["wean-1"], UnknownExperimentError, DATA_VARIABLE),
        (["--set", "belief.max_clusters=no"], SettingsError, "belief.max_clusters"),
    ],
)
def test_what_cannot_be_done_is_said_before_anything_runs(
    tmp_path: Path, arguments: list[str], kind: type[Exception], words: str
) -> None:
    out = tmp_path / "out"
    result = CliRunner().invoke(app, ["experiments", *arguments, "--out", str(out)])
    assert isinstance(result.exception, kind)
    assert words in str(result.exception)
    assert not out.exists()
