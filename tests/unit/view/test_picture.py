import json
import zlib
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from clustermcl.protocol.errors import MalformedMessageError
from clustermcl.protocol.job_events import Ended, NumberedEvent
from clustermcl.protocol.steps import MapMessage, TruePose
from clustermcl.protocol.work import Particles
from clustermcl.view import frames
from clustermcl.view.browser import MESSAGES_AHEAD, Browser
from clustermcl.view.commands import Drawn
from clustermcl.view.frames import MAX_PARTICLES, cloud_frame, reduced
from clustermcl.view.picture import NEWEST_ROWS, SLOTS, Picture, colour_slots
from clustermcl.view.step_archive import LOOK_BACK_STEPS, StepArchive
from tests.unit.coordinator.reports import particles, tracked
from tests.unit.view.messages import belief, events, map_message, pose, scan, status


@pytest.fixture
def picture() -> Picture:
    made = Picture({"robot": "r", "router": "tcp/x:1", "commands": True})
    made.changes()
    return made


def rows(encoded: list[Any]) -> list[Any]:
    """As the page reads them."""
    return [json.loads(bytes(row)) for row in encoded]


def test_a_new_page_gets_everything_there_is(picture: Picture) -> None:
    picture.on_status(status())
    picture.on_map(map_message())
    picture.on_belief(belief(5, 1, 2))
    picture.on_pose(pose(5))
    picture.on_events(events(0))
    shown = picture.everything()
    assert set(shown) == {"system", "history", "status", "map", "step", "pose", "events"}
    assert shown["system"] == {
        "robot": "r", "router": "tcp/x:1", "commands": True, "link": "running",
    }  # fmt: skip
    assert [row[0] for row in rows(shown["history"]["rows"])] == [5]
    assert (shown["status"], shown["pose"]) == (status(), pose(5))
    assert set(picture.changes()) == set(shown) - {"history"}
    assert picture.changes() == {}


def test_the_scan_of_a_step_is_drawn_with_its_belief_or_once_it_arrives(picture: Picture) -> None:
    picture.on_scan(scan(4, [2.0, 3.0, 10.0, 0.0]))  # the last two did not return
    picture.on_belief(belief(4, 1))
    assert picture.changes()["step"]["scan"] == [300, 0, 100, 300]
    picture.on_belief(belief(5, 1))
    assert picture.changes()["step"]["scan"] == []
    picture.on_scan(scan(5, [2.0, 3.0]))
    assert picture.changes()["step"]["scan"] == [300, 0, 100, 300]
    assert msgspec.json.decode(picture.past(5)["step"])["scan"] == [300, 0, 100, 300]
    picture.on_scan(scan(4, [1.0]))
    assert picture.changes() == {}


def test_a_late_true_pose_is_drawn_at_its_step_and_added_to_the_trail(picture: Picture) -> None:
    picture.on_belief(belief(5, 1))
    picture.on_truth(TruePose(sender="s", step=5, pose=(1.0, 1.0, 0.0)))
    assert picture.changes()["step"]["truth"] == (1.0, 1.0, 0.0)
    assert rows(picture.everything()["history"]["rows"])[-1][2] == [1.0, 1.0, 0.0]


def test_a_step_again_replaces_it_and_steps_that_restart_also_restart_the_history(
    picture: Picture,
) -> None:
    picture.on_belief(belief(500, 1))
    picture.on_belief(belief(500, 1, 2))
    history = rows(picture.everything()["history"]["rows"])
    assert [(row[0], len(row[1])) for row in history] == [(500, 2)]
    picture.changes()
    assert picture.past(3) == {"events": []}
    picture.on_belief(belief(0, 1))
    assert [row[0] for row in rows(picture.changes()["history"]["rows"])] == [0]
    assert "step" not in picture.past(500)


def test_a_page_gets_the_newest_rows_and_requests_earlier_ones() -> None:
    picture = Picture({})
    for step in range(NEWEST_ROWS + 5):
        picture.on_belief(belief(step, 1))
    newest = rows(picture.everything()["history"]["rows"])
    assert [newest[0][0], newest[-1][0], len(newest)] == [5, NEWEST_ROWS + 4, NEWEST_ROWS]
    assert [row[0] for row in rows(picture.rows_before(5))] == [0, 1, 2, 3, 4]
    assert picture.rows_before(0) == []


def test_a_past_step_has_the_frames_of_its_time(picture: Picture) -> None:
    picture.on_events(events(3))
    picture.on_scan(scan(5, [2.0]))
    picture.on_particles(1, particles(np.ones((20, 3)), step=5))
    picture.on_belief(belief(5, 1, 2))
    picture.on_pose(pose(5))
    picture.on_status(status())
    picture.on_belief(belief(6, 1))
    picture.on_events(events(6))
    past = picture.past(5)
    shown = {topic: json.loads(bytes(past[topic])) for topic in past if topic != "events"}
    assert shown["step"]["step"] == 5
    assert shown["step"]["scan"] == [300, 0]
    assert [place["cluster"] for place in shown["step"]["places"]] == [1, 2]
    assert shown["pose"]["pose"] == [1.0, 2.0, 0.5]
    assert shown["status"]["steps_applied"] == 6
    assert shown["cloud 1"]["cluster"] == 1
    assert [event["step"] for event in past["events"]] == [3]


def test_particles_are_removed_with_their_cluster(picture: Picture) -> None:
    picture.on_particles(1, particles(np.ones((20, 3)), step=5))
    picture.on_belief(belief(5, 1))
    cloud = picture.changes()["cloud 1"]
    assert (cloud["step"], len(cloud["points"])) == (5, 60)
    assert "cloud 1" in picture.everything()
    picture.on_belief(belief(6, 2))
    assert picture.changes()["cloud 1"] is None
    assert "cloud 1" not in picture.everything()


def test_a_coordinator_of_an_old_term_is_ignored(picture: Picture) -> None:
    picture.on_belief(belief(5, 1, term=2))
    picture.changes()
    picture.on_belief(belief(6, 1, term=1))
    picture.on_pose(pose(6, term=1))
    assert picture.changes() == {}


def test_a_restarted_system_counts_its_terms_again(picture: Picture) -> None:
    picture.on_status(status())
    picture.on_belief(belief(50, 1, term=7))
    picture.on_link("no router")
    picture.on_belief(belief(0, 1, term=1))
    assert picture.changes()["step"]["step"] == 0


def test_events_are_shown_in_order_and_a_gap_is_noticed(picture: Picture) -> None:
    assert picture.on_events(events(0, 1))
    assert not picture.on_events(events(4))
    assert picture.on_events(events(0, 1, 2, 3, 4))
    assert [e["step"] for e in picture.changes()["events"]] == [0, 1, 2, 3, 4]


def test_events_with_the_same_cause_and_step_are_one_line(picture: Picture) -> None:
    ended = [Ended(f"c{n}", "improbable", (), 1e-5) for n in range(4)]
    over = [Ended(f"s0.{n}", "search over", (), None) for n in range(3)]
    numbered = tuple(
        NumberedEvent(number=n, step=9, stamp_ns=0, event=event)
        for n, event in enumerate([*ended, *over])
    )
    picture.on_events(replace(events(), events=numbered))
    texts = [event["text"] for event in picture.changes()["events"]]
    assert texts == ["4 places dropped: improbable (< 0.1 %)", "search 0 is over"]


@pytest.mark.parametrize("first", [0, 2, 4])
def test_the_events_of_a_new_term_follow_those_before_its_first(
    picture: Picture, first: int
) -> None:
    picture.on_events(events(0, 1, 2, 3))
    assert picture.on_events(events(first, term=2))
    assert [e["step"] for e in picture.changes()["events"]] == list(range(first + 1))


def test_the_map_is_queried_until_its_digest_is_that_of_the_system(picture: Picture) -> None:
    assert not picture.has_wanted_map
    picture.on_map(map_message("d1"))
    assert picture.has_wanted_map
    picture.on_scan(scan(1, [1.0], digest="d2"))
    assert not picture.has_wanted_map
    picture.on_map(map_message("d2"))
    assert picture.has_wanted_map


@given(st.lists(st.sets(st.integers(0, 40), max_size=20), max_size=30))
def test_each_cluster_has_a_slot_of_its_own_that_never_changes(steps: list[set[int]]) -> None:
    before, most = dict[int, int](), 0
    for alive in steps:
        now = colour_slots(before, sorted(alive))
        assert now.keys() == alive
        assert len(set(now.values())) == len(now)
        assert all(now[cluster] == before[cluster] for cluster in alive & before.keys())
        most = max(most, len(alive))
        assert max(now.values(), default=0) < max(most, SLOTS)
        before = now
    assert colour_slots({}, [3, 11, 5]) == {3: 3, 11: 0, 5: 5}, "as in the plots where it is free"


def test_nothing_is_sent_while_a_slow_page_draws() -> None:
    received: list[bytes] = []
    browser = Browser(received.append)
    browser.offer({"map": b"m", "step": b"1"})
    browser.on_drawn(Drawn(1, slow=True))
    browser.offer({"step": b"2"})
    browser.offer({"step": b"3"})
    assert received == [b"{m,1}", b"{2}"], "a new page gets all frames in one message"
    for _ in range(2):  # the second has no new frame to send
        browser.on_drawn(Drawn(1, slow=True))
        assert received == [b"{m,1}", b"{2}", b"{3}"]


@pytest.mark.parametrize("together", [1, MESSAGES_AHEAD])
def test_the_newest_frame_of_each_topic_waits_for_a_fast_page(together: int) -> None:
    received: list[bytes] = []
    browser = Browser(received.append)
    for number in range(100):
        browser.offer({"step": b"%d" % number, "pose": b"p"})
    assert len(received) == MESSAGES_AHEAD
    browser.on_drawn(Drawn(together))
    assert received[MESSAGES_AHEAD:] == [b"{99,p}"]


def cloud(poses: np.ndarray, log_weights: np.ndarray) -> Particles:
    return particles(poses, log_weights, step=5, odom=(1.0, 2.0, 0.5))


def test_particles_are_given_in_centimetres_and_milliradians() -> None:
    frame = cloud_frame(3, cloud(np.array([[1.234, -5.678, 0.1234]]), np.zeros(1)))
    assert frame == {
        "cluster": 3, "step": 5, "odom": (1.0, 2.0, 0.5), "points": [123, -568, 123],
    }  # fmt: skip


def test_particles_are_drawn_in_proportion_to_their_weight() -> None:
    poses = np.zeros((3000, 3))
    poses[1000:, 0] = 1.0
    log_weights = np.where(poses[:, 0] > 0, np.log(0.25 / 2000), np.log(0.75 / 1000))
    points = cloud_frame(1, cloud(poses, log_weights))["points"]
    assert len(points) == 3 * MAX_PARTICLES
    assert np.mean(np.array(points[::3]) == 100) == pytest.approx(0.25, abs=0.01)
    points = cloud_frame(1, cloud(poses[999:1001], np.array([-np.inf, 0.0])))["points"]
    assert set(points[::3]) == {100}


def test_only_names_of_tracking_jobs_have_a_cluster_number() -> None:
    assert tracked("c12", 1, 1.0, (0.0, 0.0, 0.0)).cluster == 12
    for name in ("s3.1", "c", "c-1", "cx", "c" + "9" * 30):
        assert tracked(name, 1, 1.0, (0.0, 0.0, 0.0)).cluster is None


def shown(archive: StepArchive, step: int) -> dict[str, object]:
    return {topic: json.loads(bytes(frame)) for topic, frame in archive.at(step).items()}


@given(
    added=st.lists(st.tuples(st.integers(0, 3 * LOOK_BACK_STEPS), st.sampled_from("abc"))),
    step=st.integers(0, 3 * LOOK_BACK_STEPS), size=st.sampled_from([0, 20_000]),
)  # fmt: skip
def test_a_step_has_the_last_frame_of_each_topic_unless_it_is_old(
    added: list[tuple[int, str]], step: int, size: int
) -> None:
    archive, expected = StepArchive(), {}
    for number, (at, topic) in enumerate(sorted(added)):
        archive.add(at, topic, (number, size * "x"))
        if step - LOOK_BACK_STEPS <= at <= step:
            expected[topic] = [number, size * "x"]
    assert shown(archive, step) == expected


@pytest.mark.parametrize(("limit", "length", "oldest"), [
    ({"max_steps": 10}, 1, 90), ({"max_bytes": 1000}, 50, 99), ({"max_bytes": 10}, 1000, 100),
], ids=["steps", "bytes", "a frame larger than the archive"])  # fmt: skip
def test_frames_beyond_the_limit_drop_the_oldest_steps(
    limit: dict[str, Any], length: int, oldest: int
) -> None:
    archive = StepArchive(**limit)
    for step in range(100):
        archive.add(step, "step", list(range(step, step + length)))
    for step in (0, 89, 90, 99):
        expected = {"step": list(range(step, step + length))} if step >= oldest else {}
        assert shown(archive, step) == expected


def packed_map(cells: np.ndarray) -> MapMessage:
    rows, cols = cells.shape
    return replace(map_message(), rows=rows, cols=cols, zlib_cells=zlib.compress(cells.tobytes()))


def reduced_cells(message: MapMessage) -> list[list[int]]:
    made = reduced(message)
    assert made.cell_m == message.cell_m * 2
    packed = zlib.decompress(made.zlib_cells)
    cells: list[list[int]] = np.frombuffer(packed, np.int8).reshape(made.rows, made.cols).tolist()
    return cells


def test_in_a_reduced_map_a_wall_wins_before_a_free_cell_and_the_rim_is_kept(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(frames, "MAX_SIDE", 4)
    small = packed_map(np.zeros((4, 3), np.int8))
    assert reduced(small) is small
    cells = np.full((6, 8), -1, np.int8)
    cells[0:2, 0:2] = [[0, 0], [0, 1]]
    cells[2, 2] = 0
    assert reduced_cells(packed_map(cells)) == [[1, -1, -1, -1], [-1, 0, -1, -1], [-1] * 4]
    cells = np.zeros((7, 5), np.int8)
    cells[6, 4] = 1
    assert reduced_cells(packed_map(cells)) == [[0] * 3, [0] * 3, [0] * 3, [0, 0, 1]]
    for damaged in (b"rubbish", zlib.compress(b"\0" * 30)):
        with pytest.raises(MalformedMessageError, match="map"):
            reduced(replace(packed_map(cells), zlib_cells=damaged))
