import json
import math

import msgspec

from clustermcl.commands.as_json import dumped, json_object
from clustermcl.protocol.answers import Hypotheses
from clustermcl.protocol.job_events import Began, Ended, JobEvents, NumberedEvent
from tests.unit.evaluation.places import ANSWER, STATUS, belief, place


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
