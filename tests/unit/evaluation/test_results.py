"""What `clustermcl evaluate` writes for other programs: trajectories, and tables of runs."""

import csv
import json
import math
import re
import sys
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from evaluation.evaluate import EvaluateOptions, run_evaluate
from evaluation.references import load_reference
from evaluation.results import check_results_file, write_results
from process_runtime.output_files import OutputError
from protocol.errors import SettingsError
from tests.integration.system.conftest import SMALL

COMMON = {"algorithm": "cluster-mcl", "recording": "a, b.log", "mirrored": False, "map": None}
RUNS = [
    {"seed": 0, "localized": True, "rmse_m": 0.25, "sure_and_right_at_step": None},
    {"seed": 1, "localized": False, "rmse_m": None, "sure_and_right_at_step": 7},
]


def test_a_trajectory_has_a_line_of_eight_numbers_for_each_step(tmp_path: Path) -> None:
    tum, output = tmp_path / "run.tum", tmp_path / "run.json"
    options = EvaluateOptions(recording="sim:cross_feature", steps=12, tum=tum, output=output)
    run_evaluate(options, SMALL)
    comment, *lines = tum.read_text().splitlines()
    assert comment == "# timestamp x y z qx qy qz qw"
    assert len(lines) == 12
    number = r"-?\d+(\.\d+)?"
    assert all(re.fullmatch(rf"\d+\.\d{{9}}( {number}){{7}}", line) for line in lines)
    values = [[float(word) for word in line.split()] for line in lines]
    stamps = [row[0] for row in values]
    assert stamps == sorted(set(stamps))
    assert all(math.hypot(*row[4:]) == pytest.approx(1.0, abs=1e-8) for row in values)
    read = load_reference(tum)  # an estimate is also a reference
    last = read.pose_at(round(stamps[-1] * 1e9))
    assert last is not None
    assert last[:2] == pytest.approx(values[-1][1:3])
    assert json.loads(output.read_text())["runs"][0]["steps"] == 12


def test_a_trajectory_is_of_one_run(tmp_path: Path) -> None:
    options = EvaluateOptions(recording="sim:cross", steps=3, seeds=2, tum=tmp_path / "run.tum")
    with pytest.raises(SettingsError, match="--tum: of one run"):
        run_evaluate(options, SMALL)


def test_a_csv_has_a_row_for_each_run_with_what_is_common(tmp_path: Path) -> None:
    file = tmp_path / "runs.CSV"
    check_results_file(file)
    write_results(file, COMMON, RUNS)
    with file.open(newline="") as opened:
        rows = list(csv.DictReader(opened))
    assert [row["recording"] for row in rows] == ["a, b.log"] * 2
    assert [row["rmse_m"] for row in rows] == ["0.25", ""]
    assert pd.read_csv(file)["localized"].tolist() == [True, False]


def test_a_parquet_file_keeps_types_and_missing_values(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow", reason="the extra parquet is missing")
    file = tmp_path / "runs.parquet"
    check_results_file(file)
    write_results(file, COMMON, RUNS)
    table: Any = pd.read_parquet(file)
    assert table["seed"].tolist() == [0, 1]
    assert table["localized"].tolist() == [True, False]
    assert table["rmse_m"][0] == 0.25
    assert math.isnan(table["rmse_m"][1])


def test_parquet_without_its_library_is_refused_before_the_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    options = EvaluateOptions(recording="sim:cross", steps=3, output=tmp_path / "runs.parquet")
    with pytest.raises(SettingsError, match="Parquet needs the extra 'parquet'"):
        run_evaluate(options, SMALL)


@pytest.mark.parametrize("name", ["runs", "runs.xlsx", "runs.json.gz"])
def test_another_ending_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(SettingsError, match=r"has to end in \.json or \.csv or \.parquet"):
        check_results_file(tmp_path / name)


def test_a_folder_that_is_missing_is_named(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="its folder does not exist"):
        check_results_file(tmp_path / "no" / "runs.csv")
