import json
import math
import re
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.integration.free_port import free_port
from tests.integration.system.commands import SMALL_FILTER, TypedCommand, ran, typed
from tests.integration.view.page import frame_of, opened
from tests.integration.worlds import write_room

SHORT = ["demo", "--recording", "sim:cross_feature", "--steps", "30", "--workers", "4"]


def as_json(*words: str, environment: dict[str, str]) -> dict[str, Any]:
    done = ran(*words, "--json", environment=environment)
    assert (done.returncode, done.stderr) == (0, "")
    assert list(Path(environment["TMPDIR"]).iterdir()) == [], "nothing is left"
    answer: dict[str, Any] = json.loads(done.stdout)
    return answer


def test_a_demo_ends_by_itself_with_one_json_object(environment: dict[str, str]) -> None:
    done = ran("-v", *SHORT, "--json", *SMALL_FILTER, environment=environment)
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    assert (answer["steps"], answer["steps_lost"]) == (30, 0)
    assert set(answer["pose"]) == {"x_m", "y_m", "heading_rad", "covariance"}
    best = answer["hypotheses"][0]
    assert (best["x_m"], best["y_m"]) == (answer["pose"]["x_m"], answer["pose"]["y_m"])
    assert best["probability"] == answer["probability"]
    here = math.fsum(place["probability"] for place in answer["hypotheses"])
    assert here + answer["elsewhere_probability"] == pytest.approx(1.0)
    assert answer["final_error_m"] >= 0.0, "the simulator tells where the robot was"
    assert 0.0 <= answer["final_error_rad"] <= math.pi


def test_a_simulated_robot_in_a_users_map_is_found(
    environment: dict[str, str], tmp_path: Path
) -> None:
    """A room with one cabinet: a single view of it localizes the robot."""
    cabinet = slice(70, 100), slice(100, 130)
    file = write_room(
        tmp_path, "room", cells=(120, 160), cell_m=0.05, corner=(-3.0, 7.0), box=cabinet
    )
    file.rename(tmp_path / "hall")  # a world of ours has that name: the file is meant
    options = ["--map", str(tmp_path / "hall"), "--steps", "40", "--workers", "4"]
    answer = as_json("demo", *options, *SMALL_FILTER, environment=environment)
    assert answer["state"] == "localized"
    assert answer["final_error_m"] < 0.5
    assert -3.0 < answer["pose"]["x_m"] < 5.0
    assert 7.0 < answer["pose"]["y_m"] < 13.0


@pytest.mark.parametrize(
    ("after", "number"), [("the workers start", signal.SIGINT), ("step 0: ", signal.SIGTERM)]
)
def test_an_interrupted_demo_leaves_nothing(
    after: str, number: int, environment: dict[str, str], tmp_path: Path
) -> None:
    words = [*SHORT, "--rate", "0.5", *SMALL_FILTER]
    with typed(*words, folder=tmp_path, environment=environment) as demo:
        demo.wait_for(after)
        assert demo.end(number) == 130
        assert demo.err == ""
        demo.assert_nothing_runs()
    assert list(Path(environment["TMPDIR"]).iterdir()) == []


@pytest.fixture
def viewed(environment: dict[str, str], tmp_path: Path) -> Iterator[tuple[TypedCommand, str]]:
    """A simulated robot in a map of one's own, and the link that has just been said."""
    listen = f"127.0.0.1:{free_port()}"
    own_map = str(write_room(tmp_path, cells=(80, 120), box=(slice(20, 30), slice(20, 40))))
    words = ("--map", own_map, "--workers", "4", "--view", "--listen", listen)
    with typed("demo", *words, *SMALL_FILTER, folder=tmp_path, environment=environment) as demo:
        demo.wait_for(f"look at http://{listen}/")
        yield demo, f"http://{listen}/"


def test_a_demo_waits_for_the_first_browser(viewed: tuple[TypedCommand, str]) -> None:
    demo, link = viewed
    demo.wait_for("the workers are ready; the demo begins when the link is opened")
    time.sleep(2.0)  # in which several steps would be made
    assert "step 0" not in demo.out
    with opened(link) as page:
        while frame_of(page, "step")["step"] == 0:
            pass  # at the next step the page's server has all of step 0
        page.send('{"type": "past", "step": 0}')
        past = frame_of(page, "past")["step"]
    assert (past["step"], len(past["truth"])) == (0, 3)
    assert "At the end" not in demo.out
    assert demo.end(signal.SIGINT) == 130
    assert re.search(r"At the end .*\n(That is .* off\.\n)?\d+ steps, 0 lost", demo.out)
    assert demo.err == f"clustermcl: look at {link}\n"
    demo.assert_nothing_runs()


def test_a_demo_whose_worker_is_killed_ends_and_names_the_process(
    viewed: tuple[TypedCommand, str],
) -> None:
    demo, link = viewed
    with opened(link):
        demo.wait_for("step 0: ")
    child = next(one for one in demo.meet_family() if "clustermcl.worker" in one.cmdline())
    child.kill()
    assert demo.wait() == 2
    assert "the worker process ended with SIGKILL" in demo.err
    demo.assert_nothing_runs()
