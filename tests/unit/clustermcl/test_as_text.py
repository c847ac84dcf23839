import json
import math

import pytest
from msgspec.structs import replace

from clustermcl.commands import as_text as text
from clustermcl.commands.as_json import dumped, json_object
from clustermcl.commands.demo_output import DemoOutput, DemoSummary
from clustermcl.protocol.answers import Hypotheses
from clustermcl.protocol.job_events import Began, Ended, JobEvents, NumberedEvent
from clustermcl.protocol.why import Why, why_text
from tests.unit.evaluation.places import ANSWER, STATUS, belief, place


@pytest.mark.parametrize("turn", [0.0, 0.4, 1.2, math.pi / 2])
def test_the_spread_is_that_of_the_longer_axis_however_it_lies(turn: float) -> None:
    c, s = math.cos(turn), math.sin(turn)
    xx, xy, yy = 0.09 * c * c + 0.01 * s * s, 0.08 * c * s, 0.09 * s * s + 0.01 * c * c
    covariance = (xx, xy, 0.0, xy, yy, 0.0, 0.0, 0.0, math.radians(2.0) ** 2)
    assert text.place_text((0.0, 0.0, 0.0), covariance).endswith("  +-0.30 m, 2.0 deg")


def test_all_texts_report_that_the_robot_is_probably_off_the_map() -> None:
    lost = replace(ANSWER, elsewhere_probability=0.9, off_map_probability=0.85)
    places = Hypotheses(sender="coordinator", pose=lost, hypotheses=(place(0.1),))
    words = "not on this map"
    assert words in list(text.pose_lines(lost))[-1]
    assert words in list(text.hypotheses_lines(places))[-1]
    reported = belief(7, "lost", place(0.1), elsewhere_probability=0.9, off_map_probability=0.85)
    assert words in text.belief_line(reported)
    assert words not in " ".join(text.pose_lines(ANSWER))


def test_every_text_of_a_pose_by_dead_reckoning_or_of_old_data_says_so() -> None:
    doubts = {"freshness": "dead_reckoning", "scan_age_s": 7.51}
    unweighed, status = replace(ANSWER, **doubts), replace(STATUS, **doubts)
    places = Hypotheses(sender="coordinator", pose=unweighed, hypotheses=(place(1.0),))
    for lines in (
        list(text.pose_lines(unweighed))[1:],
        list(text.hypotheses_lines(places))[-1:],
        [next(text.status_lines(status))],
    ):
        assert "dead reckoning" in lines[0]
        assert "the last scan is 7.5 s old" in lines[0]
    old = replace(ANSWER, freshness="stale", age_s=12.34, workers=0)
    stale, without_worker = list(text.pose_lines(old))[1:]
    assert "12.3 s old" in stale
    assert "no worker" in without_worker
    reported = belief(7, "ambiguous", place(0.6, cluster=1), place(0.4, cluster=2))
    for missing in (("c1",), ("c1", "c2")):
        line = text.belief_line(replace(reported, missing=missing))
        assert ("dead reckoning" in line) == (len(missing) == 2)


def test_a_belief_is_one_line_however_many_places_there_are() -> None:
    places = [place(0.1)] * 8 + [place(0.009)] * 3
    line = text.belief_line(belief(7, "ambiguous", *places, elsewhere_probability=0.1))
    assert line.endswith("probabilities 0.10, 0.10, 0.10, 0.10, 0.10, 0.10, 5 more, elsewhere 0.10")
    unlikely = belief(9, "lost", place(0.001), place(0.0001))
    assert "probabilities 0.00, 1 more" in text.belief_line(unlikely), "the best one is shown"


def test_a_status_lists_every_process_with_what_it_does_and_dropped() -> None:
    lines = [line.strip() for line in text.status_lines(STATUS)]
    coordinator, dropped, worker, reports = lines[lines.index("processes") + 1 :]
    assert coordinator.startswith("coordinator (coordinator) 1.2, up 99 s, 50 MB")
    assert "scan of another map: 7" in dropped
    assert worker.endswith("silent for 5 s")
    assert reports == "reports: 80, 9.5/s, last 5.2 s ago"


def test_reasons_of_a_change_follow_each_place() -> None:
    why = Why({"scan": (1.25, -1.0, 0.0, 0.0), "search": (0.01, -2.0, 0.0, 0.0)}, {"fit": (0.0,)})
    both = (place(0.9, cluster=1), place(0.1, cluster=2))
    places = Hypotheses(sender="coordinator", pose=ANSWER, hypotheses=both, why=why)
    lines = list(text.hypotheses_lines(places, why=True))
    assert lines[2].strip() == "place 1: log odds +1.3 nat: scan +1.2 (fit 0.00)"
    assert lines[4].strip() == "place 2: log odds -3.0 nat: search -2.0, scan -1.0 (fit 0.00)"
    assert why_text(Why({"scan": (1.0,)}), 1) == "", "as another version may send it"


def test_a_pose_has_units_in_its_names_and_a_square_covariance() -> None:
    pose = json_object(ANSWER)["pose"]
    assert pose == {
        "x_m": 1.0,
        "y_m": 2.0,
        "heading_rad": 3.0,
        "covariance": [[0.04, 0.0, 0.0], [0.0, 0.01, 0.0], [0.0, 0.0, 0.0025]],
    }


def test_places_keep_their_order_and_without_one_there_is_no_pose() -> None:
    places = (place(0.7, cluster=4), place(0.3, cluster=1))
    for answer in (
        belief(3, "ambiguous", *places),
        Hypotheses(sender="coordinator", pose=ANSWER, hypotheses=places),
    ):
        found = json_object(answer)
        assert [each["cluster"] for each in found["hypotheses"]] == [4, 1]
        assert found["hypotheses"][0].keys() > {"x_m", "covariance", "log_odds_changes_nat"}
    found = json_object(belief(4, "searching", searching=True))
    assert found["pose"] is None
    assert (found["probability"], found["hypotheses"], found["searching"]) == (0.0, [], True)


def test_infinite_and_nan_numbers_become_null_in_json() -> None:
    text = dumped({"a": math.nan, "b": [math.inf, 1.5], "c": {"d": -math.inf}})
    assert json.loads(text) == {"a": None, "b": [None, 1.5], "c": {"d": None}}


def test_a_status_object_names_its_processes_and_has_no_schema() -> None:
    plain = json_object(STATUS)
    assert [process["name"] for process in plain["processes"]] == ["coordinator", "worker-0"]
    assert plain["processes"][1]["rates_per_s"] == {"reports": 9.5}
    assert "schema" not in dumped(plain)
    assert plain["steps_applied"] == 40


def test_events_are_flat_objects() -> None:
    merged = NumberedEvent(number=4, step=9, stamp_ns=7, event=Ended("c3", "merged", ("c1",), 0.02))
    found = NumberedEvent(number=5, step=10, stamp_ns=8, event=Began("c4", "restart", 0.03))
    answer = JobEvents(sender="coordinator", events=(merged, found), term=2)
    assert json.loads(dumped(json_object(answer))) == {
        "term": 2,
        "events": [
            {"number": 4, "step": 9, "stamp_ns": 7, "event": "ended", "job_id": "c3",
             "cause": "merged", "by": ["c1"], "probability": 0.02},
            {"number": 5, "step": 10, "stamp_ns": 8, "event": "began", "job_id": "c4",
             "cause": "restart", "probability": 0.03},
        ],
    }  # fmt: skip


def test_the_summary_names_held_places_and_the_step_of_the_decision() -> None:
    summary = DemoSummary()
    assert len(list(summary.lines(STATUS, 3.0))) == 1
    summary.on_belief(belief(0, "searching"))
    held = [place(probability) for probability in (0.5, 0.3, 0.19, 0.01)]
    for step in (1, 2):
        summary.on_belief(belief(step, "ambiguous", *held))
    for step, off_m in ((3, 5.0), (4, 0.2), (5, 0.0)):
        summary.on_belief(belief(step, "localized", place(0.97)), (off_m, 0.0, 0.0))
    assert (summary.found_step, summary.localized_steps) == (4, 3)
    assert list(summary.lines(STATUS, 3.0)) == [
        "The search found its first places at step 1.",
        "For 2 steps it was ambiguous: up to 3 places had 2% or more, the best at most 0.50.",
        "First localized at the true pose: step 4.",
        "From step 3 on the robot was localized.",
        "At the end localized with probability 0.97: "
        "x 0.00 m  y 0.00 m  heading 0.0 deg  +-0.20 m, 2.9 deg",
        "That is 0.00 m and 0.0 deg off.",
        "40 steps, 1 lost, 1 workers, 3.0 s.",
    ]
    summary.on_belief(belief(6, "ambiguous", place(0.5), place(0.5)))
    assert summary.localized_steps == 0


def test_places_below_one_per_cent_change_no_line(capsys: pytest.CaptureFixture[str]) -> None:
    output = DemoOutput("robot", as_json=False)
    output.on_belief(belief(1, "ambiguous", place(0.5), place(0.49), place(0.009)), None)
    dropped = Ended("c2", "improbable", (), 0.009), Ended("c1", "merged", ("c0",), 0.49)
    output.on_events(NumberedEvent(number=0, step=2, stamp_ns=0, event=each) for each in dropped)
    output.on_belief(belief(2, "ambiguous", place(0.5), place(0.49)), None)
    first, merged = capsys.readouterr().out.splitlines()
    assert "probabilities 0.50, 0.49, 1 more" in first
    assert merged == "step 2: place 1 merged into place 0 (49 %)"
