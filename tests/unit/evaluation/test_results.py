import csv
from pathlib import Path

import pandas as pd

from clustermcl.evaluation.results import write_results

COMMON = {"algorithm": "cluster-mcl", "recording": "a, b.log", "map": None}
RUNS = [
    {"seed": 0, "localized": True, "rmse_m": 0.25, "sure_and_right_at_step": None},
    {"seed": 1, "localized": False, "rmse_m": None, "sure_and_right_at_step": 7},
]


def test_a_csv_has_a_row_for_each_run_with_what_is_common(tmp_path: Path) -> None:
    file = tmp_path / "runs.csv"
    write_results(file, COMMON, RUNS)
    with file.open(newline="") as opened:
        rows = list(csv.DictReader(opened))
    assert [row["recording"] for row in rows] == ["a, b.log"] * 2
    assert [row["rmse_m"] for row in rows] == ["0.25", ""]
    assert pd.read_csv(file)["localized"].tolist() == [True, False]
