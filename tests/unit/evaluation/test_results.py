import csv
import math
import re
from pathlib import Path

import pandas as pd
import pytest

from evaluation.evaluate import EvaluateOptions, run_evaluate
from evaluation.references import load_reference
from evaluation.results import write_results
from tests.integration.system.conftest import SMALL

COMMON = {"algorithm": "cluster-mcl", "recording": "a, b.log", "map": None}
RUNS = [
    {"seed": 0, "localized": True, "rmse_m": 0.25, "sure_and_right_at_step": None},
    {"seed": 1, "localized": False, "rmse_m": None, "sure_and_right_at_step": 7},
]


def test_a_trajectory_has_a_line_of_eight_numbers_for_each_step(tmp_path: Path) -> None:
    tum, output = tmp_path / "run.tum", tmp_path / "runs.csv"
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
    assert pd.read_csv(output)["steps"].tolist() == [12]


def test_a_csv_has_a_row_for_each_run_with_what_is_common(tmp_path: Path) -> None:
    file = tmp_path / "runs.csv"
    write_results(file, COMMON, RUNS)
    with file.open(newline="") as opened:
        rows = list(csv.DictReader(opened))
    assert [row["recording"] for row in rows] == ["a, b.log"] * 2
    assert [row["rmse_m"] for row in rows] == ["0.25", ""]
    assert pd.read_csv(file)["localized"].tolist() == [True, False]
