import io
import json
from pathlib import Path

import pytest
from rich.console import Console

from evaluation.experiments import run as module
from evaluation.experiments.case import Case, SimulatedRobot
from evaluation.experiments.plan import Extent, Given
from evaluation.experiments.plots import MISSING
from evaluation.experiments.run import FailedRunsError, Options, run_experiments
from evaluation.experiments.suite import Suite
from process_runtime.output_files import OutputError
from process_runtime.stop import StopFlag
from tests.unit.evaluation.experiments.made_up import case

SMALL = ("search.poses=4000", "search.heading_step_rad=0.1")
"""A search that takes milliseconds, for an experiment that is not about finding anything."""


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


def offering(monkeypatch: pytest.MonkeyPatch, *cases: Case) -> None:
    monkeypatch.setattr(module, "available", lambda _data: (cases, ()))


def run(out: Path, **options: object) -> tuple[Path | None, str]:
    text = io.StringIO()
    stop = options.pop("stop", StopFlag())
    assert isinstance(stop, StopFlag)
    asked = Options(out=out, given=Given(None, SMALL), jobs=2, **options)  # type: ignore[arg-type] # tests
    return run_experiments(asked, stop, Console(file=text, width=200)), text.getvalue()


def test_a_small_experiment_from_the_options_to_the_report(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    offering(monkeypatch, case(symmetry=2))
    out = tmp_path / "out"
    report, said = run(out, extent=Extent(seeds=1, first_seed=5))
    assert report == out / "experiments.md"
    assert "1 experiments, 2 runs in 2 processes" in said
    assert "made-up: right at the end:" in said
    assert "* Cluster-MCL: seed 5, 12 updates" in report.read_text()
    held = json.loads((out / "made-up.json").read_text())
    assert held["complete"] is True
    assert [run["measures"]["updates"] for run in held["runs"]] == [12, 12]
    assert held["provenance"]["settings"]["search.poses"] == 4000


@pytest.mark.parametrize(
    ("where", "path"), [("out", "/dev/null/x"), ("report", "/dev/null/x"), ("report", "/")]
)
def test_where_nothing_can_be_written_no_run_begins(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, where: str, path: str
) -> None:
    offering(monkeypatch, case())
    monkeypatch.setattr(Suite, "run", lambda *_: pytest.fail("a run has begun"))
    options = {"out": tmp_path / "out", where: Path(path)}
    with pytest.raises(OutputError, match="cannot be written"):
        run(**options)  # type: ignore[arg-type] # both are paths


def test_plots_are_drawn_where_matplotlib_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("matplotlib")
    offering(monkeypatch, case(seeds=1))
    report, _ = run(tmp_path)
    assert report is not None
    for name in ("made-up-probabilities", "made-up-trajectories", "reliability"):
        assert (tmp_path / f"{name}.png").read_bytes().startswith(b"\x89PNG")
        assert f"]({name}.png)" in report.read_text()


def test_no_plots_are_drawn_when_nobody_wants_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    offering(monkeypatch, case(seeds=1, baselines=()))
    report, said = run(tmp_path, plots=False)
    assert report is not None
    assert MISSING not in said
    assert not list(tmp_path.glob("*.png"))


def test_without_matplotlib_everything_else_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    offering(monkeypatch, case(seeds=1, baselines=()))
    monkeypatch.setattr(module, "can_plot", lambda: False)
    report, said = run(tmp_path)
    assert MISSING in said
    assert report is not None
    assert report.is_file()
    assert not list(tmp_path.glob("*.png"))


def test_failing_runs_are_reported_beside_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    broken = case("broken", robot=SimulatedRobot(world="atlantis"), seeds=1, baselines=())
    offering(monkeypatch, case(seeds=1, baselines=()), broken)
    with pytest.raises(FailedRunsError, match="1 of 2 runs failed"):
        run(tmp_path)
    text = (tmp_path / "experiments.md").read_text()
    assert "no simulated world 'atlantis'" in text
    assert "* Cluster-MCL: seed 0, 12 updates" in text


def test_stopped_before_anything_has_ended_there_is_no_report(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    offering(monkeypatch, case(updates=3000))
    stop = StopFlag()
    stop.set()
    assert run(tmp_path / "out", stop=stop)[0] is None
    assert not (tmp_path / "out").exists()
