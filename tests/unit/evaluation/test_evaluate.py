"""What `clustermcl evaluate` says of a run, and which options it refuses."""

import math
from pathlib import Path
from typing import Any

import msgspec
import pytest
from typer.testing import CliRunner

from clustermcl.command import app
from evaluation import evaluate
from evaluation.course import RecordedRobot, SimulatedRobot
from evaluation.evaluate import EvaluateOptions, case_of, start_steps
from evaluation.measures import facts_of, measures_of
from process_runtime.output_files import OutputError
from process_runtime.settings import Settings
from protocol.answers import Hypothesis, State
from protocol.errors import SettingsError
from protocol.message import PoseTuple
from tests.unit.evaluation.places import outcome, place

TRUTH: PoseTuple = (10.0, 5.0, 3.0)
RIGHT, WRONG = (10.5, 5.0, 3.0), (14.0, 5.0, 3.0)


def judged(*steps: tuple[State, list[Hypothesis], PoseTuple | None]) -> dict[str, Any]:
    """One step a second, numbered from 0."""
    facts = [
        facts_of(step, (100 + step) * 10**9, outcome(state, *places), truth)
        for step, (state, places, truth) in enumerate(steps)
    ]
    return msgspec.structs.asdict(measures_of(facts))


def sure_of(pose: PoseTuple) -> tuple[State, list[Hypothesis], PoseTuple | None]:
    return "localized", [place(0.95, pose), place(0.05, (0.0, 0.0, 0.0))], TRUTH


def test_localized_means_right_over_the_last_ten_steps() -> None:
    wrong_before = judged(*[sure_of(WRONG)] * 3, *[sure_of(RIGHT)] * 10)
    assert wrong_before["localized"]
    assert (wrong_before["localized_at_step"], wrong_before["localized_at_s"]) == (3, 3.0)
    one_wrong = judged(*[sure_of(RIGHT)] * 8, sure_of(WRONG), *[sure_of(RIGHT)] * 9)
    assert not one_wrong["localized"]
    assert one_wrong["localized_at_step"] is one_wrong["rmse_m"] is None


def test_a_wrong_step_restarts_the_count() -> None:
    verdict = judged(*[sure_of(RIGHT)] * 20, sure_of(WRONG), *[sure_of(RIGHT)] * 12)
    assert verdict["localized_at_step"] == 21


def test_a_run_shorter_than_ten_steps_is_judged_by_all_of_them() -> None:
    assert judged(*[sure_of(RIGHT)] * 4)["localized"]
    assert not judged(sure_of(WRONG), *[sure_of(RIGHT)] * 3)["localized"]


def test_the_rmse_counts_from_where_it_stayed_right() -> None:
    first, then = sure_of((10.0, 5.9, 3.0)), sure_of((10.0, 5.5, 3.0))
    verdict = judged(sure_of(WRONG), first, *[then] * 10)
    assert verdict["rmse_m"] == pytest.approx(math.sqrt((0.9**2 + 10 * 0.5**2) / 11))


def test_the_final_error_is_that_of_the_last_judged_step() -> None:
    verdict = judged(sure_of(RIGHT), sure_of((10.0, 5.2, 3.1)), ("localized", [place(1.0)], None))
    assert verdict["final_error_m"] == pytest.approx(0.2)
    assert verdict["final_error_rad"] == pytest.approx(0.1)
    assert verdict["steps"] == 3


def test_only_a_sure_estimate_at_a_wrong_place_is_confidently_wrong() -> None:
    doubtful = ("ambiguous", [place(0.89, WRONG), place(0.11, RIGHT)], TRUTH)
    sure = ("localized", [place(0.9, WRONG)], TRUTH)
    assert judged(sure_of(RIGHT), doubtful, sure, sure)["confidently_wrong_fraction"] == 0.5


def test_during_the_first_search_no_estimate_is_counted() -> None:
    searching: tuple[State, list[Hypothesis], PoseTuple] = "searching", [place(1.0, WRONG)], TRUTH
    verdict = judged(*[searching] * 3, sure_of(RIGHT))
    assert verdict["confidently_wrong_fraction"] == 0.0
    assert verdict["truth_tracked_fraction"] == 1.0
    only = judged(searching)
    assert not only["localized"]
    assert only["final_error_m"] is only["truth_tracked_fraction"] is None


def test_any_right_place_tracks_the_truth_and_their_probabilities_add_up() -> None:
    both = ("ambiguous", [place(0.5, WRONG), place(0.3, RIGHT), place(0.2, TRUTH)], TRUTH)
    none = ("ambiguous", [place(1.0, WRONG)], TRUTH)
    verdict = judged(both, none)
    assert verdict["truth_tracked_fraction"] == 0.5
    assert verdict["truth_probability_mean"] == pytest.approx(0.25)


def test_places_forgotten_later_count_against_tracking() -> None:
    forgotten: tuple[State, list[Hypothesis], PoseTuple] = "searching", [], TRUTH
    verdict = judged(sure_of(RIGHT), forgotten)
    assert verdict["truth_tracked_fraction"] == 0.5
    assert not verdict["localized"]
    assert verdict["final_error_m"] is None


def test_without_a_reference_nothing_is_claimed() -> None:
    verdict = judged(*[("localized", [place(1.0)], None)] * 12)
    assert not verdict["localized"]
    assert verdict["confidently_wrong_fraction"] is verdict["truth_probability_mean"] is None
    assert verdict["steps"] == 12
    assert verdict["localized_fraction"] == 1.0


def test_without_ground_truth_the_first_place_ends_the_first_search() -> None:
    unjudged: tuple[State, list[Hypothesis], None] = "localized", [place(1.0)], None
    searching: tuple[State, list[Hypothesis], PoseTuple] = "searching", [], TRUTH
    assert judged(unjudged, searching, sure_of(RIGHT))["truth_tracked_fraction"] == 0.5


def test_steps_in_the_json_are_counted_from_0() -> None:
    doubtful = ("ambiguous", [place(0.6, RIGHT), place(0.4, WRONG)], TRUTH)
    verdict = judged(sure_of(WRONG), sure_of(RIGHT), doubtful)
    assert verdict["sure_and_right_at_step"] == 1
    assert verdict["truth_probability_lowest_once_sure"] == 0.6
    logs = (math.log(0.001), math.log(0.95), math.log(0.6))
    assert verdict["log_score_mean"] == pytest.approx(math.fsum(logs) / 3)
    squares = (1 + 0.95**2 + 0.05**2, 2 * 0.05**2, 2 * 0.4**2)
    assert verdict["brier_mean"] == pytest.approx(math.fsum(squares) / 3)
    assert verdict["elsewhere_probability_mean"] is None


def test_starts_are_spread_evenly_and_leave_room_for_their_steps() -> None:
    assert start_steps(steps=260, starts=3, steps_each=60) == (0, 100, 200)
    assert start_steps(steps=260, starts=1, steps_each=60) == (0,)
    assert start_steps(steps=40, starts=1, steps_each=60) == (0,)
    with pytest.raises(SettingsError, match="--starts 3: 61 steps have 2 starts with 60 each"):
        start_steps(steps=61, starts=3, steps_each=60)


def test_with_starts_a_run_has_60_steps_by_default() -> None:
    recorded = {"recording": "a.log", "map_file": "b.yaml", "starts": 8}
    assert case_of(EvaluateOptions(**recorded))[0].updates == 60
    assert case_of(EvaluateOptions(**recorded, steps=9))[0].updates == 9
    assert case_of(EvaluateOptions(**recorded, seeds=3))[1] == 3
    simulated, seeds = case_of(EvaluateOptions(recording="sim:hall", starts=8))
    assert (simulated.updates, seeds) == (60, 8)


def test_a_simulated_robot_drives_300_steps_by_default() -> None:
    case, _ = case_of(EvaluateOptions(recording="sim:hall"))
    assert (case.robot, case.updates) == (SimulatedRobot(world="hall"), 300)
    asked = EvaluateOptions(recording="sim:a.yaml", map_file="b.yaml", steps=9)
    case, _ = case_of(asked)
    robot = SimulatedRobot(world="a.yaml", map=Path("b.yaml"))
    assert (case.robot, case.updates) == (robot, 9)


def test_a_recorded_robot_drives_to_its_end() -> None:
    case, _ = case_of(EvaluateOptions(recording="a.log", map_file="b.yaml"))
    robot = RecordedRobot(recording=Path("a.log"), map=Path("b.yaml"), reference=None)
    assert (case.robot, case.updates) == (robot, None)


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"recording": "sim:hall", "reference": Path("r.tum")}, "--reference: a simulated robot"),
        ({"recording": "sim:hall", "starts": 2, "seeds": 2}, "--seeds: every start of a simul"),
        ({"recording": "a.log"}, "--map is missing: a recording needs"),
        ({"recording": "a.log", "map_file": "m", "kidnap_at": 0}, "--kidnap-at: only a simulated"),
    ],
)
def test_options_that_do_not_fit_together_are_refused(options: Any, expected: str) -> None:
    with pytest.raises(SettingsError, match=expected):
        case_of(EvaluateOptions(**options))


def test_an_unknown_algorithm_is_refused() -> None:
    with pytest.raises(SettingsError, match="slam: there is cluster-mcl or mcl or amcl"):
        evaluate.run_evaluate(EvaluateOptions(recording="sim:hall", algorithm="slam"), Settings())


@pytest.mark.parametrize("option", ["--seeds", "--starts", "--steps", "--jobs"])
def test_an_absurd_count_is_refused_at_once(option: str) -> None:
    result = CliRunner().invoke(app, ["evaluate", "sim:nowhere", option, "1000000000"])
    assert result.exit_code == 2
    assert f"Invalid value for '{option}'" in result.output
    assert "less than or equal to" in result.output


@pytest.mark.parametrize("name", ["runs", "runs.json", "runs.csv.gz"])
def test_an_output_file_that_is_not_csv_by_name_is_refused(name: str) -> None:
    options = EvaluateOptions(recording="sim:cross", output=Path(name))
    with pytest.raises(SettingsError, match=r"must end in \.csv; --json prints JSON"):
        evaluate.run_evaluate(options, Settings())


def test_an_output_file_in_a_missing_folder_is_refused_before_any_run(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(evaluate, "_all_results", lambda *_: pytest.fail("a run has begun"))
    options = EvaluateOptions(recording="sim:cross", output=Path("/nonexistent/x.csv"))
    with pytest.raises(OutputError, match=r"/nonexistent/x\.csv: cannot be written: its folder"):
        evaluate.run_evaluate(options, Settings())
