"""Figures that several experiments have."""

from evaluation.experiments.figures import mean, quantiles

RMSE = mean("once right for good: root mean square error", "rmse_m", unit="m")
CONFIDENTLY_WRONG = mean(
    "share of the updates that were confidently wrong", "confidently_wrong_share"
)
RIGHT_FOR_GOOD = quantiles("right for good from update", "settled_at_update")
SCORES = (
    mean("logarithmic score, 0 is the best", "log_score"),
    mean("Brier's score, 0 is the best", "brier"),
)
