"""Figures that several experiments have."""

from evaluation.experiments.figures import mean

RMSE = mean("once right for good: root mean square error", "rmse_m", unit="m")
CONFIDENTLY_WRONG = mean(
    "share of the updates that were confidently wrong", "confidently_wrong_share"
)
