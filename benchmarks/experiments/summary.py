"""What a table of runs says: one row for each experiment and algorithm, and comparisons."""

from pathlib import Path

import numpy as np
import pandas as pd
from scipy.stats import binomtest, wilcoxon

from benchmarks.experiments.measures import BINS
from benchmarks.experiments.run_table import COLUMNS, rows_of

OURS = "cluster-mcl"
_TEXT = ("experiment", "role", "algorithm", "version", "settings")


def read_table(path: Path) -> pd.DataFrame:
    """A table of runs; a missing measure is NaN.

    Raises:
        InputFileError: it cannot be read, or is no such table.
    """
    table = pd.DataFrame(rows_of(path), columns=list(COLUMNS))
    numbers = [column for column in COLUMNS if column not in _TEXT]
    flags = table[numbers].replace({"True": 1, "False": 0, "": np.nan})
    table[numbers] = flags.apply(pd.to_numeric)
    return table


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """One row for each experiment and algorithm.

    Shares of runs have Wilson's 95 % interval (`localized_low`, `localized_high`); means weigh
    runs by their updates; `first_right` is a median in which a run that never was counts as
    infinite. `p_score` is the p-value of a difference from Cluster-MCL in the logarithmic score
    (Wilcoxon's signed-rank test over equal seeds).

    References:
        Naeini, Cooper, Hauskrecht (2015), Obtaining well calibrated probabilities using Bayesian
        binning: the expected calibration error.
    """
    rows = []
    for (experiment, algorithm), runs in table.groupby(["experiment", "algorithm"], sort=False):
        localized = int(runs["localized"].sum())
        interval = binomtest(localized, len(runs)).proportion_ci(method="wilson")
        rows.append(
            {
                "experiment": experiment,
                "algorithm": algorithm,
                "runs": len(runs),
                "localized": localized,
                "localized_low": interval.low,
                "localized_high": interval.high,
                "first_right": runs["right_within"].fillna(np.inf).median(),
                "sure_and_wrong": _mean(runs, "confidently_wrong_share"),
                "tracked": _mean(runs, "tracked_share"),
                "log_score": _mean(runs, "log_score"),
                "brier": _mean(runs, "brier"),
                "calibration_error": _calibration_error(runs),
                "rmse_m": runs["rmse_m"].mean(),
                "entropy": runs["entropy_mean"].mean(),
                "right_after_kidnap": runs["right_after_kidnap"].median(),
                "p_score": _p_score(table, experiment, runs),
                "cpu_s": runs["cpu_s"].mean(),
            }
        )
    return pd.DataFrame(rows)


def over_all(each: pd.DataFrame) -> pd.DataFrame:
    """One row for each algorithm: the mean over its experiments, each of equal weight."""
    columns = ["log_score", "brier", "calibration_error", "sure_and_wrong"]
    means = each.groupby("algorithm", sort=False)[columns].mean()
    means.insert(0, "experiments", each.groupby("algorithm")["experiment"].count())
    return means.reset_index()


def _mean(runs: pd.DataFrame, column: str) -> float:
    known = runs[column].notna()
    weights = runs.loc[known, "updates"]
    return float(np.average(runs.loc[known, column], weights=weights)) if known.any() else np.nan


def _calibration_error(runs: pd.DataFrame) -> float:
    """Mean over all claims of |claimed - right| of the claim's tenth."""
    claims, right, claimed = (
        runs[[f"{what}_{part}" for part in range(BINS)]].sum().to_numpy(float)
        for what in ("claims", "right", "claimed")
    )
    return float(np.abs(claimed - right).sum() / claims.sum()) if claims.sum() else np.nan


def _p_score(table: pd.DataFrame, experiment: object, runs: pd.DataFrame) -> float:
    ours = table[(table["experiment"] == experiment) & (table["algorithm"] == OURS)]
    pairs = ours.merge(runs, on="seed", suffixes=("", "_other"))[["log_score", "log_score_other"]]
    pairs = pairs.dropna()
    differences = pairs["log_score"] - pairs["log_score_other"]
    return float(wilcoxon(differences).pvalue) if differences.any() else np.nan
