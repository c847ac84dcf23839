import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from evaluation.experiments.catalogue import simulated_cases
from evaluation.experiments.figures import mean, quantiles, rate, read
from evaluation.experiments.measures import RunMeasures
from tests.unit.evaluation.experiments.made_up import measures

RIGHT = rate("right at the end", "localized", at_least=1, wanted=39 / 40)
ERROR = mean("error", "rmse_m", at_most=0.15, unit="m")


def test_a_share_counts_the_runs_within_the_bounds() -> None:
    runs = [measures(localized=index > 0) for index in range(40)]
    reading = read(RIGHT, runs)
    assert (reading.passed, reading.runs, reading.value) == (39, 40, 39 / 40)
    assert (reading.low, reading.high) == pytest.approx((0.8712, 0.9956), abs=5e-5)
    assert reading.met
    assert not read(RIGHT, runs[:20]).met  # 19 of 20 is less than 39 of 40


def interval(passed: int, count: int) -> tuple[float | None, float | None]:
    """Of a share of so many runs."""
    right, wrong = measures(localized=True), measures(localized=False)
    reading = read(RIGHT, [*[right] * passed, *[wrong] * (count - passed)])
    return reading.low, reading.high


@pytest.mark.parametrize(
    ("passed", "count", "low", "high"),
    [  # as statsmodels' proportion_confint(method="wilson") and R's prop.test(correct=FALSE) say
        (20, 20, 0.8389, 1.0),
        (10, 20, 0.2993, 0.7007),
        (0, 10, 0.0, 0.2775),
        (1, 10, 0.0179, 0.4042),
        (39, 40, 0.8712, 0.9956),
    ],
)
def test_the_interval_of_a_share_is_that_of_the_tables(
    passed: int, count: int, low: float, high: float
) -> None:
    assert interval(passed, count) == pytest.approx((low, high), abs=5e-5)


@settings(deadline=None)  # the first call imports scipy.stats
@given(st.integers(1, 300).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_the_interval_holds_the_share_and_mirrors(counts: tuple[int, int]) -> None:
    passed, count = counts
    low, high = interval(passed, count)
    assert low is not None
    assert high is not None
    assert 0.0 <= low <= passed / count + 1e-12
    assert passed / count - 1e-12 <= high <= 1.0
    assert interval(count - passed, count) == pytest.approx((1.0 - high, 1.0 - low))


def test_of_no_run_nothing_is_known() -> None:
    assert interval(0, 0) == (None, None)


def test_a_run_that_failed_or_lacks_the_measure_did_not_pass() -> None:
    within = rate("soon", "right_within", at_most=50)
    reading = read(within, [measures(right_within=3), measures(), None])
    assert (reading.passed, reading.runs, reading.met) == (1, 3, False)


def test_a_mean_is_over_the_runs_that_have_it() -> None:
    reading = read(ERROR, [measures(rmse_m=0.1), measures(rmse_m=0.3), measures(), None])
    assert reading.value == pytest.approx(0.2)
    assert (reading.low, reading.high) == (0.1, 0.3)
    assert (reading.measured, reading.runs, reading.met) == (2, 4, False)


def test_a_mean_that_no_run_has_is_not_met() -> None:
    assert read(ERROR, [measures()]).met is False
    assert read(ERROR, []).met is None
    assert read(mean("error", "rmse_m"), [measures()]).met is None


def test_without_runs_or_a_target_nothing_is_met_or_not() -> None:
    assert read(RIGHT, []).met is None
    assert read(rate("right", "localized", at_least=1, wanted=None), [measures()]).met is None


def test_targets_in_words() -> None:
    assert RIGHT.target == ">= 97.5 % of the runs"
    assert rate("", "localized").target == "all runs"
    assert ERROR.target == "<= 0.15 m"
    assert mean("", "rmse_m").target == ""


def test_every_figure_reads_a_measure_that_exists() -> None:
    figures = [figure for case in simulated_cases() for figure in case.figures]
    assert {figure.measure for figure in figures} <= set(RunMeasures.__struct_fields__)


def test_experiments_have_names_of_their_own_and_something_asked() -> None:
    cases = simulated_cases()
    assert len({case.name for case in cases}) == len(cases)
    assert all(any(figure.asks for figure in case.figures) for case in cases)


def test_a_run_that_never_got_there_is_later_than_all_in_a_quantile() -> None:
    median, most = quantiles("right for good", "settled_at_update", most_median=5, most_90=9)
    runs = [measures(settled_at_update=n) for n in (9, 1, 5, 3, 7, 2, 4, 6, 8)]
    assert [read(each, [*runs, None]).value for each in (median, most)] == [5, 9]
    assert [read(each, [*runs, None]).met for each in (median, most)] == [True, True]
    twice = [*runs, measures(), measures()]
    assert [read(each, twice).value for each in (median, most)] == [6, None]
    assert [read(each, twice).met for each in (median, most)] == [False, False]
    assert (read(most, twice).measured, read(most, twice).runs) == (9, 11)
    assert read(median, []).value is read(median, []).met is None
