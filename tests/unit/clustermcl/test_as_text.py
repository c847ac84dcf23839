import math

import msgspec
import pytest

from clustermcl.commands.as_text import (
    advice_lines,
    belief_line,
    event_lines,
    hypotheses_lines,
    place_text,
    pose_lines,
    status_lines,
)
from clustermcl.protocol.advice import Advice, Way
from clustermcl.protocol.answers import Hypotheses
from clustermcl.protocol.health import SourceHealth
from clustermcl.protocol.job_events import Ended, NumberedEvent
from clustermcl.protocol.why import Why, why_text
from tests.unit.evaluation.places import ANSWER, STATUS, belief, place


@pytest.mark.parametrize("turn", [0.0, 0.4, 1.2, math.pi / 2])
def test_the_spread_is_that_of_the_longer_axis_however_it_lies(turn: float) -> None:
    c, s = math.cos(turn), math.sin(turn)
    xx, xy, yy = 0.09 * c * c + 0.01 * s * s, 0.08 * c * s, 0.09 * s * s + 0.01 * c * c
    covariance = (xx, xy, 0.0, xy, yy, 0.0, 0.0, 0.0, math.radians(2.0) ** 2)
    assert place_text((0.0, 0.0, 0.0), covariance).endswith("  +-0.30 m, 2.0 deg")


def test_a_pose_is_printed_with_the_reasons_to_doubt_it() -> None:
    old = msgspec.structs.replace(ANSWER, freshness="stale", age_s=12.34, workers=0)
    assert list(pose_lines(old))[1:] == [
        "stale: the newest data is 12.3 s old",
        "no worker is alive: the belief does not follow the robot",
    ]
    none = {"state": "searching", "freshness": "none", "pose": None, "covariance": None}
    before = msgspec.structs.replace(ANSWER, **none)
    assert list(pose_lines(before)) == ["searching: no scan has arrived yet"]
    unsure = msgspec.structs.replace(ANSWER, elsewhere_probability=0.123)
    assert list(pose_lines(unsure))[1:] == ["it may be elsewhere, with probability 0.12"]
    assert list(pose_lines(ANSWER)) == [
        "localized with probability 0.95: x 1.00 m  y 2.00 m  heading 171.9 deg  +-0.20 m, 2.9 deg"
    ]


def test_all_texts_report_that_the_robot_is_probably_off_the_map() -> None:
    lost = msgspec.structs.replace(ANSWER, elsewhere_probability=0.9, off_map_probability=0.85)
    words = "probably not on this map (0.85)"
    assert list(pose_lines(lost))[-1] == words
    places = Hypotheses(sender="coordinator", pose=lost, hypotheses=(place(0.1),))
    assert list(hypotheses_lines(places))[-1] == words
    reported = belief(7, "lost", place(0.1), elsewhere_probability=0.9, off_map_probability=0.85)
    assert belief_line(reported).endswith("elsewhere 0.90, probably not on this map")
    assert "not on" not in " ".join(pose_lines(ANSWER))


def test_a_dead_reckoned_pose_has_the_age_of_its_last_scan() -> None:
    unweighed = msgspec.structs.replace(ANSWER, freshness="dead_reckoning", scan_age_s=7.51)
    line = "dead reckoning: odometry alone moves the pose, the last scan is 7.5 s old"
    assert list(pose_lines(unweighed))[1:] == [line]
    places = Hypotheses(sender="coordinator", pose=unweighed, hypotheses=(place(1.0),))
    assert list(hypotheses_lines(places))[-2:] == ["   0.005  elsewhere", line]
    status = msgspec.structs.replace(STATUS, freshness="dead_reckoning", scan_age_s=7.51)
    assert next(status_lines(status)).endswith("the last scan is 7.5 s old")


def test_a_belief_that_no_worker_has_weighed_is_dead_reckoning() -> None:
    reported = belief(7, "ambiguous", place(0.6, cluster=1), place(0.4, cluster=2))
    assert "dead_reckoning" not in belief_line(msgspec.structs.replace(reported, missing=("c1",)))
    unweighed = msgspec.structs.replace(reported, missing=("c1", "c2"))
    assert belief_line(unweighed).startswith("step 7: ambiguous, dead reckoning; ")


def test_a_belief_is_one_line_however_many_places_there_are() -> None:
    places = [place(0.1)] * 8 + [place(0.009)] * 3
    line = belief_line(belief(7, "ambiguous", *places, searching=True, elsewhere_probability=0.1))
    assert line.startswith("step 7: ambiguous, a search runs; best x 0.00 m")
    assert line.endswith("probabilities 0.10, 0.10, 0.10, 0.10, 0.10, 0.10, 5 more, elsewhere 0.10")
    two = belief_line(belief(8, "localized", place(0.99), place(0.009)))
    assert "probabilities 0.99, 1 more, elsewhere" in two
    unlikely = belief(9, "lost", place(0.001), place(0.0001))
    assert "probabilities 0.00, 1 more" in belief_line(unlikely), "the best place is always shown"
    nearly = msgspec.structs.replace(
        belief(9, "localized", place(1.0), searching=True), search_progress=0.99
    )
    assert "localized, a search runs 99 %, the next scans decide; best" in belief_line(nearly)
    assert belief_line(belief(0, "searching", searching=True)) == "step 0: searching"
    halfway = belief(0, "searching", searching=True, search_progress=0.5)
    assert belief_line(halfway) == "step 0: searching 50 %"


def test_a_status_lists_every_process_with_what_it_does_and_dropped() -> None:
    source = SourceHealth(
        name="eye exit", recent_nat=9.4, outlier_rate=0.1, broken_probability=0.04
    )
    coordinator, worker = STATUS.processes
    processes = (coordinator, msgspec.structs.replace(worker, sources=(source,)))
    lines = list(status_lines(msgspec.structs.replace(STATUS, processes=processes)))
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
    assert list(advice_lines(Advice(sender="worker-0", step=7, ways=(way,), note="lost"))) == [
        "0 places at step 7",
        "  1. to 2.0 m at 90 deg, straight on, to ground that was not seen yet",
        "lost",
    ]
    alone = Advice(sender="worker-0", step=7, ways=(), clusters=(3,), note="")
    assert list(advice_lines(alone)) == ["1 place at step 7"]


def test_the_end_of_a_search_is_one_line_whatever_the_number_of_its_shards() -> None:
    ends = [
        NumberedEvent(number=n, step=3, stamp_ns=0, event=Ended(f"s2.{n}", "search over"))
        for n in range(4)
    ]
    assert list(event_lines(ends)) == ["step 3: search 2 is over"]


def test_reasons_of_a_change_follow_each_place() -> None:
    why = Why({"scan": (1.25, -1.0, 0.0, 0.0), "search": (0.01, -2.0, 0.0, 0.0)}, {"fit": (0.0,)})
    places = Hypotheses(
        sender="coordinator",
        pose=ANSWER,
        hypotheses=(place(0.9, cluster=1), place(0.1, cluster=2)),
        why=why,
    )
    lines = list(hypotheses_lines(places, why=True))
    assert lines[2].strip() == "place 1: log odds +1.3 nat: scan +1.2 (fit 0.00)"
    assert lines[4].strip() == "place 2: log odds -3.0 nat: search -2.0, scan -1.0 (fit 0.00)"
    assert len(list(hypotheses_lines(places))) == len(lines) - 2
    short = Why({"scan": (1.0,)})  # as another version may send it
    assert why_text(short, 1) == ""
