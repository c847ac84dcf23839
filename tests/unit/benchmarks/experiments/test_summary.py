from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from benchmarks.experiments.measures import BINS
from benchmarks.experiments.run_table import COLUMNS, RunTable
from benchmarks.experiments.summary import behind, over_all, reliability, summary
from clustermcl.protocol.errors import InputFileError
from clustermcl.runtime.settings import Settings


def runs(experiment: str, algorithm: str, **columns: list[float]) -> pd.DataFrame:
    """A run for each value; what is not given is zero."""
    count = len(next(iter(columns.values())))
    table = pd.DataFrame({name: np.zeros(count) for name in COLUMNS})
    table["experiment"], table["algorithm"], table["seed"] = experiment, algorithm, range(count)
    table["updates"], table["role"], table["settings"] = 10, "training", ""
    for name, values in columns.items():
        table[name] = values
    return table


def row(table: pd.DataFrame, experiment: str, algorithm: str) -> pd.Series:
    each = summary(table)
    chosen = (each["experiment"] == experiment) & (each["algorithm"] == algorithm)
    return each[chosen].iloc[0]


def test_a_share_of_runs_has_its_interval() -> None:
    within = [3, 5, np.nan, np.nan]  # never right: infinite in the median
    table = runs("a", "mcl", localized=[1, 1, 1, 0], right_within=within, right_after_kidnap=within)
    found = row(table, "a", "mcl")
    assert np.isinf(found["first_right"])
    assert np.isinf(found["right_after_kidnap"])
    still = row(table.assign(kidnapped_at_update=np.nan), "a", "mcl")
    assert np.isnan(still["right_after_kidnap"]), "it was never kidnapped"
    assert (found["runs"], found["localized"]) == (4, 3)
    assert 0.3 < found["localized_low"] < 0.75 < found["localized_high"] < 1.0


def test_the_calibration_error_is_the_mean_gap_over_all_claims() -> None:
    last = BINS - 1
    table = runs("a", "mcl", **{f"claims_{last}": [6, 4], f"claimed_{last}": [5.7, 3.8]})
    table[f"right_{last}"] = [3, 4]
    assert row(table, "a", "mcl")["calibration_error"] == pytest.approx((9.5 - 7) / 10)
    assert np.isnan(row(runs("a", "mcl", localized=[1]), "a", "mcl")["calibration_error"])


def test_starts_and_the_whole_recording_are_one_building() -> None:
    claims = {"claims_9": [4], "claimed_9": [3.8]}
    whole = runs("b", "cluster-mcl", right_9=[4], **claims)
    begun = runs("b-starts", "cluster-mcl", right_9=[2], start_step=[7], **claims)
    other = runs("b", "mcl", right_9=[0], **claims)
    last = reliability(pd.concat([whole, begun, other])).iloc[-1]
    assert tuple(last[["building", "runs", "estimates", "right"]]) == ("b", 2, 8, 6)
    assert last["calibration_error"] == pytest.approx((7.6 - 6) / 8)


def test_an_experiment_is_listed_as_behind_if_a_baseline_scores_better() -> None:
    table = pd.concat(
        [
            runs(name, algorithm, log_score=[score])
            for name, ours, theirs in (("a", -0.5, -0.1), ("b", -0.11, -0.1), ("c", -0.1, -0.5))
            for algorithm, score in (("cluster-mcl", ours), ("mcl", theirs))
        ]
    )
    (worse,) = behind(summary(table)).to_dict("records")
    assert (worse["experiment"], worse["algorithm"]) == ("a", "mcl")
    assert worse["lead"] == pytest.approx(0.4)
    _, mcl = over_all(summary(table)).to_dict("records")
    assert (mcl["experiments"], mcl["log_score"]) == (3, pytest.approx((-0.1 - 0.1 - 0.5) / 3))


def test_a_table_is_not_continued_with_other_settings(tmp_path: Path) -> None:
    path = tmp_path / "runs.csv"
    runs("a", "mcl", localized=[1]).assign(settings="gate=1").to_csv(path, index=False)
    with pytest.raises(InputFileError, match="its runs have gate=1; name another --output"):
        RunTable(path, Settings())
