"""Summaries of a table of runs: one row for each experiment and algorithm, and comparisons."""

from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import binomtest, wilcoxon

from benchmarks.experiments.measures import BINS
from benchmarks.experiments.run_table import COLUMNS, rows_of

Parts = NDArray[np.float64]
OURS = "cluster-mcl"
COMPARED = ("log_score", "brier", "calibration_error", "sure_and_wrong", "right_of_sure")
BEHIND_NAT = 0.02
"""A logarithmic score that is lower by this much is worse than a baseline's."""
RESAMPLED = 1000
_STARTS = "-starts"
_TEXT = ("experiment", "role", "algorithm", "version", "settings")


def read_table(path: Path) -> pd.DataFrame:
    """Return a table of runs, with NaN for each missing measure.

    Raises:
        InputFileError: the file cannot be read, or is no such table.
    """
    table = pd.DataFrame(rows_of(path), columns=list(COLUMNS))
    numbers = [column for column in COLUMNS if column not in _TEXT]
    flags = table[numbers].replace({"True": 1, "False": 0, "": np.nan})
    table[numbers] = flags.apply(pd.to_numeric)
    return table


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """Return one row for each experiment and algorithm.

    Shares of runs have Wilson's 95 % interval (`localized_low`, `localized_high`); scores and
    calibration errors have a 95 % interval from runs drawn with replacement (bootstrap). Means
    weight runs by their updates. `first_right` and `right_after_kidnap` are medians in which a run
    that never was counts as infinite; `rmse_m` is the mean of those that were localized.
    `right_of_sure` is the share of right ones among estimates with 0.9 or more. `p_score` is the
    p-value of a difference from Cluster-MCL in the logarithmic score (Wilcoxon's signed-rank test
    over equal seeds).

    References:
        Naeini, Cooper, Hauskrecht (2015), Obtaining well calibrated probabilities using Bayesian
        binning: the expected calibration error.
    """
    rows = []
    for (experiment, algorithm), runs in table.groupby(["experiment", "algorithm"], sort=False):
        localized = int(runs["localized"].sum())
        interval = binomtest(localized, len(runs)).proportion_ci(method="wilson")
        loss_low, loss_high = _bootstrap(_score_parts(runs))
        error_low, error_high = _bootstrap(_calibration_parts(runs))
        sure = runs[f"claims_{BINS - 1}"].sum()
        rows.append(
            {
                "experiment": experiment,
                "role": runs["role"].iloc[0],
                "algorithm": algorithm,
                "settings": runs["settings"].iloc[0],
                "runs": len(runs),
                "localized": localized,
                "localized_low": interval.low,
                "localized_high": interval.high,
                "first_right": _median(runs, "right_within"),
                "sure_and_wrong": _mean(runs, "confidently_wrong_share"),
                "right_of_sure": runs[f"right_{BINS - 1}"].sum() / sure if sure else np.nan,
                "lost": _mean(runs, "lost_share"),
                "tracked": _mean(runs, "tracked_share"),
                "log_score": _mean(runs, "log_score"),
                "log_score_low": -loss_high,
                "log_score_high": -loss_low,
                "brier": _mean(runs, "brier"),
                "calibration_error": float(_ratio(_calibration_parts(runs).sum(axis=0))),
                "calibration_low": error_low,
                "calibration_high": error_high,
                "rmse_m": runs["rmse_m"].mean(),
                "entropy": runs["entropy_mean"].mean(),
                "right_after_kidnap": _median(
                    runs[runs["kidnapped_at_update"].notna()], "right_after_kidnap"
                ),
                "p_score": _p_score(table, experiment, runs),
            }
        )
    return pd.DataFrame(rows)


def over_all(each: pd.DataFrame) -> pd.DataFrame:
    """Return one row for each algorithm: its means, and Cluster-MCL's over the same experiments.

    Experiments have equal weight; those with other settings than the defaults do not count.
    """
    known = each[each["settings"] == ""].set_index("experiment")
    ours = known.loc[known["algorithm"] == OURS, list(COMPARED)]
    rows = []
    for algorithm, theirs in known.groupby("algorithm", sort=False):
        same = ours[ours.index.isin(theirs.index)].mean().add_prefix("ours_")
        means = theirs[list(COMPARED)].mean()
        rows.append({"algorithm": algorithm, "experiments": len(theirs), **means, **same})
    return pd.DataFrame(rows)


def behind(each: pd.DataFrame) -> pd.DataFrame:
    """Return the experiments in which a baseline has a better logarithmic score, worst first."""
    ours = each.loc[each["algorithm"] == OURS, ["experiment", "log_score"]]
    both = each.merge(ours, on="experiment", suffixes=("", "_ours"))
    both["lead"] = both["log_score"] - both["log_score_ours"]
    worse = both[both["lead"] > BEHIND_NAT].sort_values("lead", ascending=False)
    return worse[
        ["experiment", "algorithm", "runs", "log_score", "log_score_ours", "lead", "p_score"]
    ]


def reliability(table: pd.DataFrame) -> pd.DataFrame:
    """Return Cluster-MCL's estimates by building and tenth of their probability.

    The runs through a recording and those from starts all over it are one building.
    """
    ours = table[(table["algorithm"] == OURS) & (table["settings"] == "")]
    rows = []
    for building, runs in ours.groupby(ours["experiment"].str.removesuffix(_STARTS), sort=False):
        parts = _calibration_parts(runs)
        low, high = _bootstrap(parts)
        rows += [
            {
                "building": building,
                "role": runs["role"].iloc[0],
                "runs": len(runs),
                "calibration_error": float(_ratio(parts.sum(axis=0))),
                "calibration_low": low,
                "calibration_high": high,
                "tenth": part,
                "estimates": runs[f"claims_{part}"].sum(),
                "right": runs[f"right_{part}"].sum(),
                "probability_sum": runs[f"claimed_{part}"].sum(),
            }
            for part in range(BINS)
        ]
    return pd.DataFrame(rows)


def starts(table: pd.DataFrame) -> pd.DataFrame:
    """Return Cluster-MCL's runs that start all over a recording; steps count from 0."""
    runs = table[table["experiment"].str.endswith(_STARTS) & (table["algorithm"] == OURS)]
    runs = runs.sort_values(["experiment", "start_step"])
    return pd.DataFrame(
        {
            "recording": runs["experiment"].str.removesuffix(_STARTS),
            "start_step": runs["start_step"].astype(int),
            "sure_and_right_at_step": (runs["sure_and_right_at_update"] - 1).astype("Int64"),
            "confidently_wrong_fraction": runs["confidently_wrong_share"],
            "truth_tracked_fraction": runs["tracked_share"],
            "log_score_mean": runs["log_score"],
            "final_error_m": runs["final_error_m"],
            "rmse_m": runs["rmse_m"],
        }
    )


def rivals(table: pd.DataFrame) -> pd.DataFrame:
    """Return each algorithm's runs that start all over a recording, a row for each recording.

    `sure_at_step` is a median in which a run that was never sure and right counts as infinite.
    """
    runs = table[table["experiment"].str.endswith(_STARTS)]
    rows = [
        {
            "recording": str(experiment).removesuffix(_STARTS),
            "algorithm": algorithm,
            "runs": len(each),
            "sure_at_step": _median(each, "sure_and_right_at_update") - 1.0,
            "sure_and_wrong": _mean(each, "confidently_wrong_share"),
        }
        for (experiment, algorithm), each in runs.groupby(["experiment", "algorithm"], sort=False)
    ]
    return pd.DataFrame(rows)


def _median(runs: pd.DataFrame, column: str) -> float:
    """Return the median; a run in which it never happened counts as infinite."""
    return float(runs[column].fillna(np.inf).median())


def _mean(runs: pd.DataFrame, column: str) -> float:
    known = runs[column].notna()
    weights = runs.loc[known, "updates"]
    return float(np.average(runs.loc[known, column], weights=weights)) if known.any() else np.nan


def _score_parts(runs: pd.DataFrame) -> Parts:
    """Return (runs, 2): the sum of the logarithmic scores, and how many they are."""
    known = runs[runs["log_score"].notna()]
    return np.stack([known["log_score"] * known["updates"], known["updates"]], axis=-1)


def _calibration_parts(runs: pd.DataFrame) -> Parts:
    """Return (runs, bins + 1): by tenth, claimed less right; and how many claims there are."""
    claims, right, claimed = (
        runs[[f"{what}_{part}" for part in range(BINS)]].to_numpy(float)
        for what in ("claims", "right", "claimed")
    )
    return np.column_stack([claimed - right, claims.sum(axis=1)])


def _ratio(parts: Parts) -> Parts:
    """Return the sum of all but the last column's absolute values, divided by the last column."""
    with np.errstate(invalid="ignore"):
        return np.abs(parts[..., :-1]).sum(axis=-1) / parts[..., -1]


def _bootstrap(parts: Parts) -> tuple[float, float]:
    """Return the 95 % interval of `_ratio` over runs that are drawn with replacement."""
    if not parts[:, -1].any():
        return np.nan, np.nan
    drawn = np.random.default_rng(0).integers(len(parts), size=(RESAMPLED, len(parts)))
    low, high = np.nanpercentile(_ratio(parts[drawn].sum(axis=1)), (2.5, 97.5))
    return float(low), float(high)


def _p_score(table: pd.DataFrame, experiment: object, runs: pd.DataFrame) -> float:
    ours = table[(table["experiment"] == experiment) & (table["algorithm"] == OURS)]
    pairs = ours.merge(runs, on="seed", suffixes=("", "_other"))[["log_score", "log_score_other"]]
    pairs = pairs.dropna()
    differences = pairs["log_score"] - pairs["log_score_other"]
    return float(wilcoxon(differences).pvalue) if differences.any() else np.nan
