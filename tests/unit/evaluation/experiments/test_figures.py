import pytest

from evaluation.experiments.catalogue import simulated_cases
from evaluation.experiments.figures import mean, rate, read
from evaluation.experiments.measures import RunMeasures
from evaluation.experiments.wilson import wilson_interval
from tests.unit.evaluation.experiments.made_up import measures

RIGHT = rate("right at the end", "localized", at_least=1, wanted=39 / 40)
ERROR = mean("error", "rmse_m", at_most=0.15, unit="m")


def test_a_share_counts_the_runs_within_the_bounds() -> None:
    runs = [measures(localized=index > 0) for index in range(40)]
    reading = read(RIGHT, runs)
    assert (reading.passed, reading.runs, reading.value) == (39, 40, 39 / 40)
    assert (reading.low, reading.high) == wilson_interval(39, 40)
    assert reading.met
    assert not read(RIGHT, runs[:20]).met  # 19 of 20 is less than 39 of 40


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
