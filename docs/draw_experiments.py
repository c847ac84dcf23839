"""Draws docs/experiments.svg and docs/starts.svg from the tables in docs/experiments.

python docs/draw_experiments.py    (needs the extras `dev` and `plots`)
"""

from pathlib import Path

import matplotlib as mpl
import pandas as pd

mpl.use("svg")
import matplotlib.pyplot as plt

HERE = Path(__file__).parent
INKS = {
    "cluster-mcl": "#0072b2", "amcl-visibility": "#d55e00", "mcl": "#009e73",
    "paper-letter": "#cc79a7", "amcl": "#e69f00",
}  # fmt: skip
NAMES = {
    "cluster-mcl": "Cluster-MCL", "amcl-visibility": "augmented MCL with visibility",
    "mcl": "ordinary MCL", "paper-letter": "the paper's letter", "amcl": "augmented MCL",
}  # fmt: skip
NEVER = 68
STYLE = {
    "font.size": 9,
    "svg.hashsalt": "clustermcl",
    "svg.fonttype": "none",
    "axes.spines.top": False,
    "axes.spines.right": False,
}


def main() -> None:
    """Draw both."""
    with plt.rc_context(STYLE):
        draw_scores()
        draw_starts()


def draw_scores() -> None:
    """The logarithmic score of each algorithm in each experiment."""
    table = pd.read_csv(HERE / "experiments" / "summary.csv")
    scores = table.pivot_table("log_score", "experiment", "algorithm")
    scores = scores.sort_values("cluster-mcl")
    figure, axes = plt.subplots(figsize=(7.5, 0.2 * len(scores) + 1))
    for algorithm, ink in reversed(INKS.items()):
        axes.plot(scores[algorithm], scores.index, "o", color=ink, label=NAMES[algorithm])
    axes.set_xlabel("logarithmic score: 0 is the best, -6.9 the worst")
    axes.grid(axis="y", alpha=0.3)
    axes.legend(loc="upper left")
    save(figure, "experiments.svg")


def draw_starts() -> None:
    """At which step each robot that started anywhere on a recording was sure and right."""
    starts = pd.read_csv(HERE / "experiments" / "starts.csv")
    known = starts["sure_and_right_at_step"].fillna(NEVER)
    rows = {name: -row for row, name in enumerate(starts["recording"].unique())}
    level = starts.assign(known=known).groupby(["recording", "known"]).cumcount()
    figure, axes = plt.subplots(figsize=(7.5, 4.5))
    axes.scatter(
        known + level // 8 * 0.6,
        starts["recording"].map(rows) + level % 8 * 0.09,
        s=9,
        c=["#d55e00" if never else "#0072b2" for never in known == NEVER],
    )
    axes.set_yticks(list(rows.values()), list(rows))
    axes.set_xticks([*range(0, 61, 10), NEVER + 1], [*map(str, range(0, 61, 10)), "not by 60"])
    axes.set_xlabel("sure and right at step; each dot is one of 20 starts")
    save(figure, "starts.svg")


def save(figure: "mpl.figure.Figure", name: str) -> None:
    """As SVG without a date, so that an equal picture is an equal file."""
    figure.savefig(HERE / name, bbox_inches="tight", metadata={"Date": None})


if __name__ == "__main__":
    main()
