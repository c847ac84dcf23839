import csv
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

from benchmarks.experiments.__main__ import app
from benchmarks.experiments.catalogue import DATA_VARIABLE
from clustermcl.protocol.errors import InputFileError, SettingsError


@pytest.fixture(autouse=True)
def no_recordings(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(DATA_VARIABLE, raising=False)


@pytest.fixture(autouse=True)
def own_signals() -> Iterator[None]:
    """The command handles SIGINT and SIGTERM; the tests restore what was there before."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def test_the_list_names_the_experiments() -> None:
    result = CliRunner().invoke(app, ["--list"])
    assert result.exit_code == 0
    for name in ("cross-feature", "kidnap-office", "people"):
        assert name in result.output


@pytest.mark.parametrize(
    ("arguments", "kind", "words"),
    [
        (["crosss"], SettingsError, "the experiments are cross,"),
        (["--algorithm", "magic"], SettingsError, "there is cluster-mcl"),
        (["--set", "belief.max_clusters=no"], SettingsError, "belief.max_clusters"),
        (["--summary"], InputFileError, "cannot be read as a table"),
    ],
)
def test_a_wrong_argument_is_refused_before_anything_runs(
    tmp_path: Path, arguments: list[str], kind: type[Exception], words: str
) -> None:
    out = tmp_path / "runs.csv"
    result = CliRunner().invoke(app, [*arguments, "--output", str(out)])
    assert isinstance(result.exception, kind)
    assert words in str(result.exception)


def test_runs_go_into_the_table_once_and_are_summarised(tmp_path: Path) -> None:
    out = str(tmp_path / "runs.csv")
    words = ["hall", "--seeds", "1", "--output", out, "--jobs", "2"]
    words += ["--algorithm", "cluster-mcl", "--algorithm", "mcl", "--set", "cluster.particles=300"]
    for _ in range(2):
        result = CliRunner().invoke(app, words)
        assert result.exit_code == 0, result.exception
        assert f"2 runs are in {out}" in result.output
    with Path(out).open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert sorted(row["algorithm"] for row in rows) == ["cluster-mcl", "mcl"]
    assert {row["settings"] for row in rows} == {"cluster.particles=300"}
    reported = CliRunner().invoke(app, ["--summary", "--output", out])
    assert reported.exit_code == 0, reported.exception
    assert reported.output.startswith("experiment,role,algorithm,settings,runs,localized")
    assert "hall,training,cluster-mcl,cluster.particles=300,1,1" in reported.output
    reported = CliRunner().invoke(app, ["--summary", "--output", out, "--tables", str(tmp_path)])
    assert reported.exit_code == 0, reported.exception
    assert (tmp_path / "summary.csv").read_text().startswith("experiment,role,")
    assert (tmp_path / "starts.csv").read_text().startswith("recording,start_step,")
