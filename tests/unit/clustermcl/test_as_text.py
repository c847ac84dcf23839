import json
import math

import msgspec
import pytest

from clustermcl.commands import as_text as text
from clustermcl.commands.as_json import dumped, json_object
from clustermcl.commands.demo_output import DemoOutput, DemoSummary
from clustermcl.protocol.advice import Advice, Way
from clustermcl.protocol.answers import Hypotheses
from clustermcl.protocol.health import SourceHealth
from clustermcl.protocol.job_events import Began, Ended, JobEvents, NumberedEvent
from clustermcl.protocol.why import Why, why_text
from tests.unit.evaluation.places import ANSWER, STATUS, belief, place


@pytest.mark.parametrize("turn", [0.0, 0.4, 1.2, math.pi / 2])
def test_the_spread_is_that_of_the_longer_axis_however_it_lies(turn: float) -> None:
    c, s = math.cos(turn), math.sin(turn)
    xx, xy, yy = 0.09 * c * c + 0.01 * s * s, 0.08 * c * s, 0.09 * s * s + 0.01 * c * c
    covariance = (xx, xy, 0.0, xy, yy, 0.0, 0.0, 0.0, math.radians(2.0) ** 2)
    assert text.place_text((0.0, 0.0, 0.0), covariance).endswith("  +-0.30 m, 2.0 deg")


def test_a_pose_is_printed_with_the_reasons_to_doubt_it() -> None:
    old = msgspec.structs.replace(ANSWER, freshness="stale", age_s=12.34, workers=0)
    assert list(text.pose_lines(old))[1:] == [
        "stale: the newest data is 12.3 s old",
        "no worker is alive: the belief does not follow the robot",
    ]
    none = {"state": "searching", "freshness": "none", "pose": None, "covariance": None}
    before = msgspec.structs.replace(ANSWER, **none)
    assert list(text.pose_lines(before)) == ["searching: no scan has arrived yet"]
    unsure = msgspec.structs.replace(ANSWER, elsewhere_probability=0.123)
    assert list(text.pose_lines(unsure))[1:] == ["it may be elsewhere, with probability 0.12"]
    assert list(text.pose_lines(ANSWER)) == [
        "localized with probability 0.95: x 1.00 m  y 2.00 m  heading 171.9 deg  +-0.20 m, 2.9 deg"
    ]


def test_all_texts_report_that_the_robot_is_probably_off_the_map() -> None:
    lost = msgspec.structs.replace(ANSWER, elsewhere_probability=0.9, off_map_probability=0.85)
    words = "probably not on this map (0.85)"
    assert list(text.pose_lines(lost))[-1] == words
    places = Hypotheses(sender="coordinator", pose=lost, hypotheses=(place(0.1),))
    assert list(text.hypotheses_lines(places))[-1] == words
    reported = belief(7, "lost", place(0.1), elsewhere_probability=0.9, off_map_probability=0.85)
    assert text.belief_line(reported).endswith("elsewhere 0.90, probably not on this map")
    assert "not on" not in " ".join(text.pose_lines(ANSWER))


def test_a_dead_reckoned_pose_has_the_age_of_its_last_scan() -> None:
    unweighed = msgspec.structs.replace(ANSWER, freshness="dead_reckoning", scan_age_s=7.51)
    line = "dead reckoning: odometry alone moves the pose, the last scan is 7.5 s old"
    assert list(text.pose_lines(unweighed))[1:] == [line]
    places = Hypotheses(sender="coordinator", pose=unweighed, hypotheses=(place(1.0),))
    assert list(text.hypotheses_lines(places))[-2:] == ["   0.005  elsewhere", line]
    status = msgspec.structs.replace(STATUS, freshness="dead_reckoning", scan_age_s=7.51)
    assert next(text.status_lines(status)).endswith("the last scan is 7.5 s old")


def test_a_belief_that_no_worker_has_weighed_is_dead_reckoning() -> None:
    reported = belief(7, "ambiguous", place(0.6, cluster=1), place(0.4, cluster=2))
    assert "dead_reckoning" not in text.belief_line(
        msgspec.structs.replace(reported, missing=("c1",))
    )
    unweighed = msgspec.structs.replace(reported, missing=("c1", "c2"))
    assert text.belief_line(unweighed).startswith("step 7: ambiguous, dead reckoning; ")


def test_a_belief_is_one_line_however_many_places_there_are() -> None:
    places = [place(0.1)] * 8 + [place(0.009)] * 3
    line = text.belief_line(
        belief(7, "ambiguous", *places, searching=True, elsewhere_probability=0.1)
    )
    assert line.startswith("step 7: ambiguous, a search runs; best x 0.00 m")
    assert line.endswith("probabilities 0.10, 0.10, 0.10, 0.10, 0.10, 0.10, 5 more, elsewhere 0.10")
    two = text.belief_line(belief(8, "localized", place(0.99), place(0.009)))
    assert "probabilities 0.99, 1 more, elsewhere" in two
    unlikely = belief(9, "lost", place(0.001), place(0.0001))
    assert "probabilities 0.00, 1 more" in text.belief_line(unlikely), (
        "the best place is always shown"
    )
    nearly = msgspec.structs.replace(
        belief(9, "localized", place(1.0), searching=True), search_progress=0.99
    )
    assert "localized, a search runs 99 %, the next scans decide; best" in text.belief_line(nearly)
    assert text.belief_line(belief(0, "searching", searching=True)) == "step 0: searching"
    halfway = belief(0, "searching", searching=True, search_progress=0.5)
    assert text.belief_line(halfway) == "step 0: searching 50 %"


def test_a_status_lists_every_process_with_what_it_does_and_dropped() -> None:
    source = SourceHealth(
        name="eye exit", recent_nat=9.4, outlier_rate=0.1, broken_probability=0.04
    )
    coordinator, worker = STATUS.processes
    processes = (coordinator, msgspec.structs.replace(worker, sources=(source,)))
    lines = list(text.status_lines(msgspec.structs.replace(STATUS, processes=processes)))
    assert lines[lines.index("processes") + 1 :] == [
        "  coordinator (coordinator) 1.2, up 99 s, 50 MB",
        "    dropped or refused: scan of another map: 7"
        " (the bridge and this process have different maps)",
        "  worker-0 (worker) 1.1, up 9 s, silent for 5 s",
        "    reports: 80, 9.5/s, last 5.2 s ago",
        "    source eye exit: 9.4 nat in 20 steps, broken with probability 4%",
    ]


def test_a_way_to_unseen_ground_is_printed_without_information() -> None:
    way = Way(
        poses=((0.0, 0.0, 0.0), (0.0, 2.0, math.pi / 2)), length_m=2.0, turn_rad=math.pi / 2,
        information=0.0, sure_probability=0.0, explores=True, sight_bearing_rad=0.0,
        sight_ranges_m=(),
    )  # fmt: skip
    assert list(text.advice_lines(Advice(sender="worker-0", step=7, ways=(way,), note="lost"))) == [
        "0 places at step 7",
        "  1. to 2.0 m at 90 deg, straight on, to ground that was not seen yet",
        "lost",
    ]
    alone = Advice(sender="worker-0", step=7, ways=(), clusters=(3,), note="")
    assert list(text.advice_lines(alone)) == ["1 place at step 7"]


def test_the_end_of_a_search_is_one_line_whatever_the_number_of_its_shards() -> None:
    ends = [
        NumberedEvent(number=n, step=3, stamp_ns=0, event=Ended(f"s2.{n}", "search over"))
        for n in range(4)
    ]
    assert list(text.event_lines(ends)) == ["step 3: search 2 is over"]


def test_reasons_of_a_change_follow_each_place() -> None:
    why = Why({"scan": (1.25, -1.0, 0.0, 0.0), "search": (0.01, -2.0, 0.0, 0.0)}, {"fit": (0.0,)})
    places = Hypotheses(
        sender="coordinator",
        pose=ANSWER,
        hypotheses=(place(0.9, cluster=1), place(0.1, cluster=2)),
        why=why,
    )
    lines = list(text.hypotheses_lines(places, why=True))
    assert lines[2].strip() == "place 1: log odds +1.3 nat: scan +1.2 (fit 0.00)"
    assert lines[4].strip() == "place 2: log odds -3.0 nat: search -2.0, scan -1.0 (fit 0.00)"
    assert len(list(text.hypotheses_lines(places))) == len(lines) - 2
    short = Why({"scan": (1.0,)})  # as another version may send it
    assert why_text(short, 1) == ""


def test_a_pose_has_units_in_its_names_and_a_square_covariance() -> None:
    pose = json_object(ANSWER)["pose"]
    assert pose == {
        "x_m": 1.0,
        "y_m": 2.0,
        "heading_rad": 3.0,
        "covariance": [[0.04, 0.0, 0.0], [0.0, 0.01, 0.0], [0.0, 0.0, 0.0025]],
    }


def test_a_pose_has_the_ages_of_odometry_and_of_the_last_scan() -> None:
    found = json_object(msgspec.structs.replace(ANSWER, freshness="dead_reckoning", scan_age_s=7.5))
    assert (found["freshness"], found["age_s"], found["scan_age_s"]) == ("dead_reckoning", 0.5, 7.5)
    assert json_object(STATUS)["scan_age_s"] == -1.0


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


END = "40 steps, 1 lost, 1 workers, 3.0 s."


def test_the_summary_lists_held_places_and_the_step_of_the_decision() -> None:
    summary = DemoSummary()
    assert list(summary.lines(STATUS, 3.0)) == [END]
    summary.on_belief(belief(0, "searching"))
    for step in (1, 2):
        summary.on_belief(
            belief(step, "ambiguous", place(0.5), place(0.3), place(0.19), place(0.01))
        )
    for event in (
        Ended("c2", "merged", ("c0",), 0.19),
        Ended("c3", "merged", ("c0",), 0.01),
        Ended("c4", "pushed out", ("c5",), 0.01),
        Ended("s0.0", "search over"),
    ):
        summary.on_event(NumberedEvent(number=0, step=2, stamp_ns=0, event=event))
    for step in (3, 4, 5):
        summary.on_belief(belief(step, "localized", place(0.97), place(0.03)))
    assert list(summary.lines(STATUS, 3.0)) == [
        "The search found its first places at step 1.",
        "For 2 steps up to 3 places were tracked, with probabilities from 0.19 to 0.50.",
        "Dropped places: 2 merged, 1 pushed out.",
        "From step 3 on the robot was localized.",
        "At the end localized with probability 0.97: "
        "x 0.00 m  y 0.00 m  heading 0.0 deg  +-0.20 m, 2.9 deg",
        END,
    ]
    assert summary.localized_steps == 3
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


def test_the_first_step_that_is_localized_at_the_true_pose_is_named() -> None:
    summary = DemoSummary()
    for step, state, off_m in (
        (0, "ambiguous", 0.0), (1, "localized", 5.0), (2, "localized", 0.2), (3, "localized", 0.0),
    ):  # fmt: skip
        summary.on_belief(belief(step, state, place(0.95)), (off_m, 0.0, 0.0))
    assert summary.found_step == 2
    lines = list(summary.lines(STATUS, 3.0, DemoSummary()))
    assert "First localized at the true pose: step 2." in lines
    assert lines[-3:] == ["That is 0.00 m and 0.0 deg off.", END, "The robot that wandered: never."]
