"""`clustermcl view FILE.mcap`: a recorded run on the page, without any system."""

import json
import re
import signal
import urllib.request
import zlib
from pathlib import Path
from typing import Any

from clustermcl.simulator.worlds.catalogue import world
from tests.integration.free_port import free_port
from tests.integration.system.commands import SMALL_FILTER, typed
from tests.integration.view.page import frame_of, frames, opened
from tests.integration.waiting import PATIENCE_S

STEPS = 15


def test_a_recorded_run_is_shown_from_its_first_step_to_its_last(tmp_path: Path) -> None:
    flights, port = tmp_path / "flights", free_port()
    robot = ("demo", "--recording", "sim:cross", "--steps", str(STEPS), "--workers", "1")
    words = (*robot, "--set", f"recorder.folder={flights}", *SMALL_FILTER)
    with typed(*words, folder=tmp_path) as recording:
        assert recording.wait(2 * PATIENCE_S) == 0, recording.err
    file = next((flights / "robot").glob("*.mcap")).rename(tmp_path / "<run>.mcap")
    words = ("view", str(file), "--listen", f"127.0.0.1:{port}")
    with typed(*words, folder=tmp_path) as viewer:
        viewer.wait_for("look at")
        link = f"http://127.0.0.1:{port}"
        with opened(f"{link}/") as page:
            shown: dict[str, Any] = {}
            for each in frames(page):
                shown |= each
                if shown["system"]["link"] == "finished":
                    break
            page.send('{"type": "past", "step": 10}')
            past = frame_of(page, "past")
        map_link = f"{link}/map/{shown['map']['digest']}"
        with urllib.request.urlopen(map_link, timeout=PATIENCE_S) as answer:
            assert zlib.decompress(answer.read()) == world("cross").map.cells.tobytes()
        assert viewer.end(signal.SIGINT) == 0, viewer.err
    saved = tmp_path / "run.html"
    with typed("view", str(file), "--save", str(saved), folder=tmp_path) as saving:
        assert saving.wait() == 0, saving.err
    assert "<run>" not in saved.read_text()  # it would end the data, were it a tag of HTML
    (data,) = re.findall(r'id="saved">(.*?)</script>', saved.read_text())
    assert [row[0] for row in json.loads(data)["history"]["rows"]] == list(range(STEPS))
    assert shown["step"]["step"] == STEPS - 1
    assert not shown["system"]["commands"]
    assert past["step"]["step"] == 10
    assert past["step"]["places"]
    assert len(past["step"]["scan"]) > 20
