"""The part of a report about all experiments together."""

from collections.abc import Callable, Iterator, Sequence

from evaluation.experiments.case import ALGORITHMS, NAMES, Algorithm
from evaluation.experiments.reliability import BINS
from evaluation.experiments.report_tables import NOTHING, number, table
from evaluation.experiments.results import ExperimentResult
from evaluation.experiments.summary import (
    LEAST_RIGHT_WHEN_SURE,
    MOST_CALIBRATION_ERROR,
    MOST_CONFIDENTLY_WRONG,
    Summary,
    summary,
)

Summaries = dict[Algorithm, Summary]
"""Of Cluster-MCL first, then of what ran beside it."""


def baselines_of(results: Sequence[ExperimentResult]) -> tuple[Algorithm, ...]:
    """All algorithms that ran beside Cluster-MCL somewhere, in their own order."""
    found = {algorithm for result in results for algorithm in result.case.baselines}
    return tuple(algorithm for algorithm in ALGORITHMS if algorithm in found)


def reliability_lines(results: Sequence[ExperimentResult]) -> Iterator[str]:
    """Scores, calibration and sure errors over all experiments that run with the defaults."""
    algorithms: tuple[Algorithm, ...] = ("cluster-mcl", *baselines_of(results))
    pools = {algorithm: summary(results, algorithm) for algorithm in algorithms}
    updates = ", ".join(f"{pool.updates:,} of {NAMES[name]}" for name, pool in pools.items())
    yield "## Reliability over all experiments"
    yield ""
    yield (
        f"Over these updates, all with the one set of defaults: {updates}. Experiments with "
        "settings of their own are not in. Where each experiment counts alike, long runs in "
        "symmetric worlds, where equal shares are right for free, weigh no more than others."
    )
    yield ""
    yield from table(
        ("over all experiments", "target", "Cluster-MCL", "met", *_others(pools)),
        [
            _row(
                pools,
                "logarithmic score, each experiment counted alike",
                lambda p: p.log_score_each,
            ),
            _row(pools, "Brier's score, each experiment counted alike", lambda p: p.brier_each),
            _row(
                pools,
                "expected calibration error of the estimate (10 bins), each experiment's own",
                lambda p: p.calibration_error_each,
                at_most=MOST_CALIBRATION_ERROR,
            ),
            _row(
                pools,
                "the same of all updates pooled",
                lambda p: p.estimates.expected_calibration_error,
                at_most=MOST_CALIBRATION_ERROR,
            ),
            _row(
                pools,
                "expected calibration error of all places held",
                lambda p: p.places.expected_calibration_error,
            ),
            _row(
                pools,
                "confidently wrong, share of the updates",
                lambda p: p.confidently_wrong,
                at_most=MOST_CONFIDENTLY_WRONG,
            ),
            _row(
                pools,
                "confidently wrong, each experiment counted alike",
                lambda p: p.confidently_wrong_each,
            ),
            _row(pools, "sure (0.9 or more), share of the updates", lambda p: p.sure_share),
            _row(
                pools,
                "right, of the estimates with probability 0.9 or more",
                lambda p: p.right_when_sure,
                at_least=LEAST_RIGHT_WHEN_SURE,
            ),
            _row(pools, "`localized` and wrong, share of the updates", lambda p: p.localized_wrong),
        ],
    )
    yield ""
    yield from _bins(pools)
    yield ""
    yield "Risk and coverage: whoever trusts estimates from a probability on trusts them on this"
    yield "share of the updates, and this share of those trusted is right."
    yield ""
    yield from _risk_coverage(pools)


def _others(pools: Summaries) -> list[str]:
    return [NAMES[algorithm] for algorithm in pools if algorithm != "cluster-mcl"]


def _row(
    pools: Summaries,
    text: str,
    value_of: Callable[[Summary], float | None],
    *,
    at_least: float | None = None,
    at_most: float | None = None,
) -> tuple[str, ...]:
    ours, *others = (value_of(pool) for pool in pools.values())
    target, met = NOTHING, NOTHING
    if at_least is not None:
        target = f">= {at_least:g}"
        met = _met(ours is not None and ours >= at_least)
    elif at_most is not None:
        target = f"<= {at_most:g}"
        met = _met(ours is not None and ours <= at_most)
    return text, target, _number(ours), met, *map(_number, others)


def _met(met: bool) -> str:
    return "yes" if met else "**no**"


def _number(value: float | None) -> str:
    return NOTHING if value is None else number(value)


def _bins(pools: Summaries) -> Iterator[str]:
    """What was claimed and what came true, bin by bin."""
    columns = ["claimed", "estimates", "mean claimed", "right"]
    for name in _others(pools):
        columns += [f"{name}: estimates", "right"]
    rows = []
    for index in range(BINS):
        mine, *others = (pool.estimates.bins[index] for pool in pools.values())
        row = [f"{index / BINS:.1f} to {(index + 1) / BINS:.1f}", f"{mine.claims:,}"]
        row += [_share(mine.mean_probability, mine.claims), _share(mine.right_share, mine.claims)]
        for other in others:
            row += [f"{other.claims:,}", _share(other.right_share, other.claims)]
        rows.append(row)
    yield from table(columns, rows)


def _risk_coverage(pools: Summaries) -> Iterator[str]:
    """For each tenth: how much is trusted from there on, and how much of that is right."""
    columns = ["trusted from"]
    for algorithm in pools:
        columns += [f"{NAMES[algorithm]}: trusted", "right"]
    rows = []
    for threshold in range(BINS):
        row = [f"{threshold / BINS:.1f}"]
        for pool in pools.values():
            part = pool.estimates.at_least(threshold)
            row += [_share(part.claims / max(pool.updates, 1), pool.updates)]
            row += [_share(part.right_share, part.claims)]
        rows.append(row)
    yield from table(columns, rows)


def _share(value: float, of: int) -> str:
    return f"{value:.3f}" if of else NOTHING
