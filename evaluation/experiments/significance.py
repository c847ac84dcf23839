"""Whether two algorithms differ by more than chance: a p-value beside every comparison."""

from collections.abc import Mapping

import numpy as np

from evaluation.experiments.figures import Figure
from evaluation.experiments.measures import RunMeasures

RunsBySeed = Mapping[int, RunMeasures | None]
"""The runs of one algorithm; None: the run failed."""


def p_value(figure: Figure, ours: RunsBySeed, theirs: RunsBySeed) -> float | None:
    """How probable a difference like this is if both algorithms do alike, two-sided.

    A share of runs: McNemar's exact test where both have the same seeds, for the runs are pairs
    of one robot, and Fisher's exact test where not. A mean or a quantile: Wilcoxon's signed-rank
    test of the pairs in which both have the measure; a quantile's missing measures are infinite.

    Args:
        figure: what is compared.
        ours: runs of one algorithm.
        theirs: runs of the other.

    Returns:
        None where there is nothing to compare.
    """
    if not ours or not theirs:
        return None
    if figure.kind == "share of runs":
        passed = {seed: figure.passes(run) for seed, run in ours.items()}
        others = {seed: figure.passes(run) for seed, run in theirs.items()}
        return (
            _mcnemar(passed, others) if passed.keys() == others.keys() else _fisher(passed, others)
        )
    return _wilcoxon(figure, ours, theirs)


def _mcnemar(ours: Mapping[int, bool], theirs: Mapping[int, bool]) -> float:
    """Exact: of the pairs that differ, each half goes one way by chance."""
    from scipy.stats import binomtest  # noqa: PLC0415 - heavy, for reports only

    better = sum(ours[seed] and not theirs[seed] for seed in ours)
    worse = sum(theirs[seed] and not ours[seed] for seed in ours)
    return float(binomtest(better, better + worse).pvalue) if better + worse else 1.0


def _fisher(ours: Mapping[int, bool], theirs: Mapping[int, bool]) -> float:
    from scipy.stats import fisher_exact  # noqa: PLC0415 - heavy, for reports only

    counts = [(sum(each.values()), len(each)) for each in (ours, theirs)]
    table = np.array([(passed, runs - passed) for passed, runs in counts])
    return float(fisher_exact(table).pvalue)


def _wilcoxon(figure: Figure, ours: RunsBySeed, theirs: RunsBySeed) -> float | None:
    from scipy.stats import wilcoxon  # noqa: PLC0415 - heavy, for reports only

    pairs = [(figure.value_of(ours[s]), figure.value_of(theirs[s])) for s in ours if s in theirs]
    both = [(mine, other) for mine, other in pairs if mine is not None and other is not None]
    if not both:
        return None
    # Never is later than anything: a large number ranks as infinity would.
    differences = [max(min(m, 1e9), -1e9) - max(min(o, 1e9), -1e9) for m, o in both]
    return float(wilcoxon(differences).pvalue) if any(differences) else 1.0
