import math
from pathlib import Path
from typing import Any

import msgspec
import pandas as pd
import pytest
from PIL import Image
from typer.testing import CliRunner

from clustermcl.commands import evaluate
from clustermcl.commands.command import app
from clustermcl.commands.evaluate import robot_of, start_steps
from clustermcl.evaluation.measures import facts_of, measures_of
from clustermcl.evaluation.run import RecordedRobot, SimulatedRobot
from clustermcl.protocol.answers import Hypothesis, State
from clustermcl.protocol.errors import SettingsError
from clustermcl.protocol.message import PoseTuple
from clustermcl.runtime.output_files import OutputError
from tests.unit.evaluation.places import outcome, place

TRUTH: PoseTuple = (10.0, 5.0, 3.0)
RIGHT, WRONG = (10.5, 5.0, 3.0), (14.0, 5.0, 3.0)


def scored(*steps: tuple[State, list[Hypothesis], PoseTuple | None]) -> dict[str, Any]:
    """One step a second, numbered from 0."""
    facts = [
        facts_of(step, (100 + step) * 10**9, outcome(state, *places), truth)
        for step, (state, places, truth) in enumerate(steps)
    ]
    return msgspec.structs.asdict(measures_of(facts))


def sure_of(pose: PoseTuple) -> tuple[State, list[Hypothesis], PoseTuple | None]:
    return "localized", [place(0.95, pose), place(0.05, (0.0, 0.0, 0.0))], TRUTH


SURE, LOST = sure_of(RIGHT), sure_of(WRONG)
FIRST_SEARCH = "searching", [place(1.0, WRONG)], TRUTH
FORGOTTEN = "searching", list[Hypothesis](), TRUTH
UNSCORED = "localized", [place(1.0)], None
DOUBTFUL = "ambiguous", [place(0.89, WRONG), place(0.11, RIGHT)], TRUTH
SPLIT = "ambiguous", [place(0.5, WRONG), place(0.3, RIGHT), place(0.2, TRUTH)], TRUTH
LEADS = "ambiguous", [place(0.6, RIGHT), place(0.4, WRONG)], TRUTH


@pytest.mark.parametrize(("steps", "expected"), [
    ([LOST] * 3 + [SURE] * 10, {"localized": True, "localized_at_step": 3, "localized_at_s": 3.0}),
    ([SURE] * 8 + [LOST] + [SURE] * 9,
     {"localized": False, "localized_at_step": None, "rmse_m": None}),
    ([SURE] * 20 + [LOST] + [SURE] * 12, {"localized_at_step": 21}),
    ([SURE] * 4, {"localized": True}),
    ([LOST] + [SURE] * 3, {"localized": False}),
    ([LOST, sure_of((10.0, 5.9, 3.0))] + [sure_of((10.0, 5.5, 3.0))] * 10,
     {"rmse_m": math.sqrt((0.9**2 + 10 * 0.5**2) / 11)}),
    ([SURE, sure_of((10.0, 5.2, 3.1)), UNSCORED],
     {"final_error_m": 0.2, "final_error_rad": 0.1, "steps": 3}),
    ([SURE, DOUBTFUL, LOST, LOST], {"confidently_wrong_fraction": 0.5}),
    ([FIRST_SEARCH] * 3 + [SURE],
     {"confidently_wrong_fraction": 0.0, "truth_tracked_fraction": 1.0}),
    ([FIRST_SEARCH],
     {"localized": False, "final_error_m": None, "truth_tracked_fraction": None}),
    ([SPLIT, ("ambiguous", [place(1.0, WRONG)], TRUTH)],
     {"truth_tracked_fraction": 0.5, "truth_probability_mean": 0.25}),
    ([SURE, FORGOTTEN],
     {"truth_tracked_fraction": 0.5, "localized": False, "final_error_m": None}),
    ([UNSCORED] * 12,
     {"localized": False, "confidently_wrong_fraction": None, "truth_probability_mean": None,
      "steps": 12, "localized_fraction": 1.0}),
    ([UNSCORED, FORGOTTEN, SURE], {"truth_tracked_fraction": 0.5}),
    ([("localized", [place(0.4, WRONG), place(0.35, RIGHT), place(0.15, TRUTH)], TRUTH)],
     {"log_score_mean": math.log(0.5), "brier_mean": 0.25 + 0.16}),
    ([("lost", [], TRUTH)], {"log_score_mean": math.log(0.001), "brier_mean": 1.0}),
    ([LOST, SURE, LEADS],
     {"sure_and_right_at_step": 1, "truth_probability_lowest_once_sure": 0.6,
      "log_score_mean": (math.log(0.001) + math.log(0.95) + math.log(0.6)) / 3,
      "brier_mean": (1 + 0.95**2 + 0.05**2 + 2 * 0.05**2 + 2 * 0.4**2) / 3,
      "elsewhere_probability_mean": None}),
], ids=[
    "right over the last ten steps", "one of them wrong", "a wrong step restarts the count",
    "a short run", "a short run with a wrong step", "the rmse from where it stayed right",
    "the error of the last scored step", "sure at a wrong place", "the first search is not counted",
    "only a first search", "any place tracks the truth", "places forgotten later",
    "no reference", "the first place ends the first search", "right places add up", "no place",
    "steps are counted from 0",
])  # fmt: skip
def test_the_scores_of_a_run_follow_from_its_steps(
    steps: list[tuple[State, list[Hypothesis], PoseTuple | None]], expected: dict[str, object]
) -> None:
    scores = scored(*steps)
    assert {name: scores[name] for name in expected} == pytest.approx(expected)


def test_starts_are_spread_evenly_and_leave_room_for_their_steps() -> None:
    assert start_steps(steps=260, starts=3, steps_each=60) == (0, 100, 200)
    assert start_steps(steps=260, starts=1, steps_each=60) == (0,)
    assert start_steps(steps=40, starts=1, steps_each=60) == (0,)
    with pytest.raises(SettingsError, match="--starts 3: 61 steps allow 2 starts of 60 steps"):
        start_steps(steps=61, starts=3, steps_each=60)


HALL = SimulatedRobot(world="hall")
LOG = RecordedRobot(recording=Path("a.log"), map=Path("b.yaml"))


def test_robots_are_named_by_their_source() -> None:
    assert robot_of("sim:hall", None, None) == HALL
    assert robot_of("a.log", "b.yaml", None) == LOG
    other = SimulatedRobot(world="a.yaml", map=Path("b.yaml"))
    assert robot_of("sim:a.yaml", "b.yaml", None) == other


def test_an_output_file_in_a_missing_folder_is_refused_before_any_run(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(evaluate, "_all_results", lambda *_: pytest.fail("a run has begun"))
    words = ["evaluate", "sim:cross", "--output", "/nonexistent/x.csv"]
    refused = CliRunner().invoke(app, words).exception
    assert isinstance(refused, OutputError)
    assert "/nonexistent/x.csv: cannot be written: its folder" in str(refused)


def test_a_row_and_a_picture_have_the_measures_of_a_run(tmp_path: Path) -> None:
    words = ["evaluate", "sim:hall", "--steps", "8", "--output", str(tmp_path / "runs.csv")]
    words += ["--plot", str(tmp_path / "run.png")]
    small = ["--set", "belief.max_clusters=4", "--set", "cluster.particles=200"]
    assert CliRunner().invoke(app, [*words, *small]).exit_code == 0
    with Image.open(tmp_path / "run.png") as picture:
        assert len(picture.convert("RGB").getcolors(2**24)) > 100  # path, colour bar, two curves
    (row,) = pd.read_csv(tmp_path / "runs.csv").to_dict("records")
    assert (row["recording"], row["steps"], row["localized"]) == ("sim:hall", 8, True)
