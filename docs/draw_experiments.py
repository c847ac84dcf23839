"""Draws the pictures of measurements, such as experiments.svg, from the tables in docs/experiments.

python docs/draw_experiments.py    (needs the extra `plots`)
"""

from pathlib import Path

import matplotlib as mpl
import pandas as pd

mpl.use("svg")
import matplotlib.pyplot as plt

HERE = Path(__file__).parent
INKS = {
    "cluster-mcl": "#0072b2", "mcl": "#009e73", "amcl-tuned": "#d55e00", "amcl": "#e69f00",
    "paper-letter": "#cc79a7",
}  # fmt: skip
MARKS = "osD^v"
NAMES = {
    "cluster-mcl": "Cluster-MCL", "mcl": "ordinary MCL", "amcl-tuned": "augmented MCL, tuned",
    "amcl": "augmented MCL", "paper-letter": "the paper's letter",
}  # fmt: skip
NEVER = 68
NAMED_ABOVE_PERCENT = 3.0
COLUMNS = 6
STYLE = {
    "font.size": 9,
    "svg.hashsalt": "clustermcl",
    "svg.fonttype": "none",
    "axes.spines.top": False,
    "axes.spines.right": False,
}


def main() -> None:
    """Draw all."""
    with plt.rc_context(STYLE):
        draw_scores()
        draw_rivals()
        draw_starts()
        draw_reliability()
        draw_advice()


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


def draw_rivals() -> None:
    """How often each algorithm is sure and wrong, by how soon it is sure and right."""
    table = pd.read_csv(HERE / "experiments" / "rivals.csv")
    figure, axes = plt.subplots(figsize=(7.5, 3.4))
    for (algorithm, ink), mark in zip(INKS.items(), MARKS, strict=True):
        theirs = table[table["algorithm"] == algorithm]
        late, wrong = theirs["sure_at_step"].clip(upper=NEVER), 100.0 * theirs["sure_and_wrong"]
        axes.scatter(late, wrong, 40, ink, marker=mark, label=NAMES[algorithm], alpha=0.75)
        for name, x, y in zip(theirs["recording"], late, wrong, strict=True):
            if y > NAMED_ABOVE_PERCENT:
                axes.annotate(name, (x, y), (5, 3), textcoords="offset points", fontsize=8)
    axes.set_yscale("symlog", linthresh=1.0)
    axes.set_yticks([0, 1, 10, 100], ["0", "1", "10", "100"])
    axes.set_ylim(-0.15, 100)
    axes.set_xticks([*range(0, 61, 10), NEVER], [*map(str, range(0, 61, 10)), "not by 60"])
    axes.set_xlabel("sure and right at step, median of the starts")
    axes.set_ylabel("sure and wrong [% of the steps]")
    axes.legend()
    save(figure, "rivals.svg")


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


def draw_reliability() -> None:
    """How often an estimate is right, by its probability, in each building."""
    table = pd.read_csv(HERE / "experiments" / "reliability.csv")
    buildings = list(table.groupby("building", sort=False))
    rows = -(-len(buildings) // COLUMNS)
    figure, grid = plt.subplots(
        rows, COLUMNS, figsize=(7.5, 1.45 * rows), sharex=True, sharey=True, layout="constrained"
    )
    for axes, (building, tenths) in zip(grid.flat, buildings, strict=False):
        filled = tenths[tenths["estimates"] > 0]
        axes.plot([0, 1], [0, 1], color="#999999", linewidth=0.8)
        axes.scatter(
            filled["probability_sum"] / filled["estimates"],
            filled["right"] / filled["estimates"],
            s=4 + 46 * filled["estimates"] / filled["estimates"].sum(),
            color="#0072b2",
        )
        axes.set_title(f"{building}: {tenths['calibration_error'].iloc[0]:.3f}", fontsize=7)
        axes.tick_params(labelsize=7)
    for axes in grid.flat[len(buildings) :]:
        axes.set_axis_off()
    figure.supxlabel("probability of the estimate, mean of each tenth", fontsize=8)
    figure.supylabel("share that is right", fontsize=8)
    save(figure, "reliability.svg")


def draw_advice() -> None:
    """What each advised way gained, by its predicted information; and the means of quarters."""
    ways = pd.read_csv(HERE / "experiments" / "advice.csv")
    figure, axes = plt.subplots(figsize=(5.0, 3.2))
    axes.scatter(ways["information"], ways["gained"], s=8, color="#0072b2", alpha=0.5)
    quarters = ways.groupby(pd.qcut(ways["information"], 4))[["information", "gained"]].mean()
    axes.plot(quarters["information"], quarters["gained"], "o", color="#d55e00")
    axes.axline((0.0, 0.0), slope=1.0, color="#999999", linewidth=0.8)
    axes.set_xlabel("predicted information [nat]; orange: means of quarters")
    axes.set_ylabel("gained by the right place [nat]")
    save(figure, "advice.svg")


def save(figure: "mpl.figure.Figure", name: str) -> None:
    """As SVG without a date, so that an equal picture is an equal file."""
    figure.savefig(HERE / name, bbox_inches="tight", metadata={"Date": None})


if __name__ == "__main__":
    main()
