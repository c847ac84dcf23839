from pathlib import Path

import pytest

from evaluation.experiments.plan import (
    Extent,
    Given,
    UnknownExperimentError,
    chosen,
    estimated_s,
    extended,
    tasks_of,
)
from protocol.errors import SettingsError
from tests.unit.evaluation.experiments.made_up import case

CASES = (case("short"), case("long", typical_updates=1000, asked_seeds=5))
CACHE = Path("cache")


def test_experiments_are_chosen_by_name_in_their_own_order() -> None:
    assert chosen(CASES, ["long", "short"], "") == CASES
    assert chosen(CASES, [], "") == CASES
    with pytest.raises(UnknownExperimentError, match="no experiment 'shor', did you mean short"):
        chosen(CASES, ["shor"], "")
    with pytest.raises(UnknownExperimentError, match="known are short, long; no recordings"):
        chosen(CASES, ["xyz"], "; no recordings")


def test_the_extent_decides_how_many_runs() -> None:
    long = CASES[1]
    assert extended(long, Extent()).seeds == 2
    assert extended(long, Extent(all_asked=True)).seeds == 5
    assert extended(long, Extent(seeds=7)).seeds == 7
    assert extended(CASES[0], Extent(seeds=1)).asked_seeds == 2
    quick = extended(case(updates=3000, seeds=40), Extent(quick=True))
    assert quick.seeds == 2
    assert quick.updates == 120


def test_what_ends_after_an_event_is_not_cut_short() -> None:
    ends = case(updates=3000, updates_after_event=40)
    assert extended(ends, Extent(quick=True)).updates == 3000


def test_every_algorithm_gets_the_same_seeds() -> None:
    of_all = case(seeds=3, baselines=("mcl", "amcl-visibility"))
    tasks = tasks_of([of_all, case("alone", baselines=())], 4, Given(), CACHE)
    runs = {(task.case.name, task.algorithm, task.seed) for task in tasks}
    three = {("made-up", name, seed) for name in of_all.algorithms for seed in (4, 5, 6)}
    assert runs == three | {("alone", "cluster-mcl", seed) for seed in (4, 5)}
    assert len(tasks) == len(runs)


def test_first_seeds_come_first_and_long_runs_before_short_ones() -> None:
    tasks = tasks_of(CASES, 10, Given(None, ["belief.max_clusters=3"]), CACHE)
    order = [(task.case.name, task.algorithm, task.seed) for task in tasks]
    assert order == [
        ("long", "mcl", 10),
        ("long", "cluster-mcl", 10),
        ("short", "mcl", 10),
        ("short", "cluster-mcl", 10),
        ("long", "mcl", 11),
        ("long", "cluster-mcl", 11),
        ("short", "mcl", 11),
        ("short", "cluster-mcl", 11),
    ]
    assert {task.settings.belief.max_clusters for task in tasks} == {3}
    assert [task.with_trace for task in tasks] == [True] * 4 + [False] * 4


def test_settings_of_the_experiment_win_over_those_of_the_command() -> None:
    own = case(settings=("belief.transition_probability=0",))
    tasks = tasks_of([own], 0, Given(None, ["belief.transition_probability=0.5"]), CACHE)
    assert {task.settings.belief.transition_probability for task in tasks} == {0.0}
    with pytest.raises(SettingsError):
        tasks_of([own], 0, Given(None, ["belief.nothing=1"]), CACHE)


def test_the_estimate_is_the_work_over_the_processes_but_no_less_than_the_longest_run() -> None:
    tasks = tasks_of([CASES[1]], 0, Given(), CACHE)  # 2 x 1 s and 2 x 2 s, and the setting up
    setup_s = estimated_s(tasks, 40) - 2.0
    assert 0.0 < setup_s < 1.0
    assert estimated_s(tasks, 1) == pytest.approx(6.0 + 4 * setup_s)
    assert estimated_s(tasks, 2) == pytest.approx(3.0 + 2 * setup_s)
