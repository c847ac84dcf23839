import json
from pathlib import Path

import msgspec
import pytest

from evaluation.experiments.report import ReportInput, report_text
from evaluation.experiments.report_tables import number, seeds_text
from evaluation.experiments.results import (
    ExperimentResult,
    RunRecord,
    write_result,
    write_text,
)
from evaluation.experiments.summary import summary
from process_runtime.output_files import OutputError
from tests.unit.evaluation.experiments.made_up import ORIGIN, a_run, claims, measures, result


def some_runs() -> list[RunRecord]:
    return [
        a_run(seed=1, localized=True, rmse_m=0.1, updates=10, wall_s=0.5),
        a_run(seed=0, localized=False, updates=10, wall_s=0.5),
        a_run("mcl", localized=False, updates=10),
    ]


def report(*results: ExperimentResult, **changed: object) -> str:
    given = ReportInput(provenance=ORIGIN, results=results, wall_s=90.0)
    for name, value in changed.items():
        object.__setattr__(given, name, value)
    return report_text(given, Path("docs"))


def test_the_report_has_a_row_for_each_figure_with_interval_and_ordinary_mcl() -> None:
    text = report(result(some_runs(), asked_seeds=5))
    assert (
        "| [made-up](#made-up) | right at the end | all runs | 1 of 2 | 9% to 91% | **no** "
        "| 0 of 1 (p 1) |"
    ) in text
    assert ("| error once right | <= 0.15 m | 0.1 m (1 of 2 runs) | 0.1 to 0.1 | yes | – |") in text
    assert "1 of 2 targets are met." in text
    assert "* Cluster-MCL: seeds 0 to 1, 20 updates, 50.0 ms each." in text


def test_the_report_says_where_it_comes_from_and_what_to_hold_against_it() -> None:
    text = report(
        result(some_runs(), asked_seeds=5),
        interrupted=True,
        quick=True,
        left_out=("Recordings are left out.",),
    )
    assert "    clustermcl experiments made-up" in text
    assert "* Version 1.2.3, commit abc, 2001-02-03 04:05 UTC." in text
    assert "`belief.max_clusters = 3`" in text
    for words in ("**Interrupted**", "**Quick**", "Recordings are left out.", "made-up 2 of 5"):
        assert words in text


def test_failed_runs_are_named_and_count_as_not_right() -> None:
    failed = RunRecord(algorithm="cluster-mcl", seed=2, problem="the map is missing")
    text = report(result([*some_runs(), failed]))
    assert "* **Failed**: cluster-mcl, seed 2: the map is missing" in text
    assert "| 1 of 3 |" in text


def test_plots_are_shown_by_paths_relative_to_the_report() -> None:
    plots = {"made-up": [Path("docs/plots/made-up-trajectories.png")]}
    text = report(result(some_runs()), plots=plots)
    assert "![made-up: trajectories](plots/made-up-trajectories.png)" in text


def test_the_file_holds_every_run_and_figure(tmp_path: Path) -> None:
    path = write_result(result(some_runs()), tmp_path / "new")
    assert path == tmp_path / "new" / "made-up.json"
    held = json.loads(path.read_text())
    assert held["complete"] is False
    assert held["role"] == "validation"
    assert held["seeds"] == {"cluster-mcl": [0, 1], "mcl": [0]}
    assert held["provenance"]["command"] == ORIGIN.command
    assert held["figures"]["cluster-mcl"][0]["reading"]["passed"] == 1
    assert [run["measures"]["localized"] for run in held["runs"]] == [False, True, False]
    assert msgspec.convert(held["runs"], list[RunRecord])[1].measures == measures(
        localized=True, rmse_m=0.1, updates=10, wall_s=0.5
    )


def test_a_result_that_cannot_be_written_is_one_clear_error(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="cannot be written"):
        write_text(tmp_path / "file" / "report.md", "text")


def test_the_pool_leaves_out_experiments_with_settings_of_their_own() -> None:
    sure = RunRecord(
        algorithm="cluster-mcl",
        seed=0,
        measures=measures(updates=30, confidently_wrong_share=0.1),
        reliability=claims((0.95, True), (0.95, False)),
    )
    calm = RunRecord(
        algorithm="cluster-mcl",
        seed=0,
        measures=measures(updates=10, confidently_wrong_share=0.0),
        reliability=claims((0.5, True)),
    )
    own = result([sure], name="own", settings=("belief.max_clusters=1",))
    pool = summary([result([sure]), result([calm], name="calm"), own], "cluster-mcl")
    assert pool.updates == 40
    assert pool.confidently_wrong == pytest.approx(0.075)
    assert pool.confidently_wrong_each == pytest.approx(0.05)
    assert pool.estimates.claims == 3
    assert pool.right_when_sure == 0.5
    assert pool.sure_share == pytest.approx(2 / 40)


def test_where_each_experiment_counts_alike_its_updates_count_by_their_number() -> None:
    long = [a_run(updates=30, log_score=-1.0, brier=0.4), a_run(updates=10, log_score=-0.2)]
    short = [a_run(updates=1, log_score=-0.4, brier=0.2)]
    pool = summary([result(long), result(short, name="short")], "cluster-mcl")
    assert pool.log_score_each == pytest.approx((-0.8 - 0.4) / 2)
    assert pool.brier_each == pytest.approx((0.4 + 0.2) / 2)  # one run was not judged


def test_what_is_trusted_from_a_probability_on_is_told_with_what_is_right_of_it() -> None:
    sure = RunRecord(
        algorithm="cluster-mcl",
        seed=0,
        measures=measures(updates=8),
        reliability=claims((0.95, True), (0.95, False), (0.5, True), (0.15, False)),
    )
    lines = report(result([sure])).splitlines()
    assert (
        "| trusted from | Cluster-MCL: trusted | right | ordinary MCL: trusted | right |" in lines
    )
    assert "| 0.0 | 0.500 | 0.500 | – | – |" in lines
    assert "| 0.2 | 0.375 | 0.667 | – | – |" in lines
    assert "| 0.9 | 0.250 | 0.500 | – | – |" in lines


def test_every_baseline_has_a_column_and_none_where_it_did_not_run() -> None:
    both = result([a_run(localized=True)], baselines=("mcl", "amcl-visibility"))
    text = report(both, result([a_run(localized=True)], name="alone", baselines=()))
    assert "| met | ordinary MCL | augmented MCL with visibility |" in text
    assert (
        "| [alone](#alone) | right at the end | all runs | 1 of 1 | 21% to 100% | yes | – | – |"
        in text
    )
    assert "* Augmented MCL with visibility: no run." in text
    assert "A validation building." in text


def test_of_no_run_there_is_no_summary() -> None:
    pool = summary([], "mcl")
    assert pool.confidently_wrong is pool.right_when_sure is None
    assert "| confidently wrong, share of the updates | <= 0.01 | – | **no** |" in report()


def test_numbers_and_seeds_as_people_write_them() -> None:
    assert [number(value) for value in (0.0, 0.12345, 1595.2, 12.3456)] == [
        "0",
        "0.123",
        "1595",
        "12.3",
    ]
    assert seeds_text([2, 0, 1]) == "seeds 0 to 2"
    assert seeds_text([3, 0]) == "seeds 0, 3"
    assert seeds_text([4]) == "seed 4"
