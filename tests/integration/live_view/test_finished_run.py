"""`clustermcl view FILE.mcap`: a recorded run on the page, without any system."""

import base64
import json
import os
import re
import signal
import urllib.request
import zlib
from pathlib import Path
from typing import Any

from websockets.sync.client import ClientConnection

from robot_simulator.worlds.catalogue import world
from tests.integration.free_port import free_port
from tests.integration.live_view.page import opened
from tests.integration.system.commands import SMALL_FILTER, typed
from tests.integration.waiting import PATIENCE_S

STEPS = 15


def test_a_recorded_run_is_shown_from_its_first_step_to_its_last(tmp_path: Path) -> None:
    file, port = tmp_path / "<run>.mcap", free_port()
    robot = ("demo", "--recording", "sim:cross", "--steps", str(STEPS), "--workers", "1")
    words = (*robot, "--record", str(file), *SMALL_FILTER)
    with typed(*words, folder=tmp_path, environment=dict(os.environ)) as recording:
        assert recording.popen.wait(2 * PATIENCE_S) == 0, recording.err
    words = ("view", str(file), "--listen", f"127.0.0.1:{port}")
    with typed(*words, folder=tmp_path, environment=dict(os.environ)) as viewer:
        viewer.wait_for("look at")
        link = f"http://127.0.0.1:{port}"
        with opened(f"{link}/") as page:
            shown = finished(page)
            page.send('{"type": "past", "step": 10}')
            past = answer_of(page, "past")
        ground = world("cross").map
        with urllib.request.urlopen(
            f"{link}/map/{shown['map']['digest']}", timeout=PATIENCE_S
        ) as answer:
            cells = zlib.decompress(answer.read())
        assert viewer.end(signal.SIGINT) == 0, viewer.err
    saved = tmp_path / "run.html"
    with typed(
        "view", str(file), "--save", str(saved), folder=tmp_path, environment=dict(os.environ)
    ) as saving:
        assert saving.popen.wait(PATIENCE_S) == 0, saving.err
    assert "<run>" not in saved.read_text()  # it would end the data, were it a tag of HTML
    assert steps_in(saved.read_text()) == list(range(STEPS))
    assert cells == ground.cells.tobytes()
    assert shown["step"]["step"] == STEPS - 1
    assert not shown["system"]["commands"]
    assert past["step"]["step"] == 10
    assert past["step"]["places"]
    assert len(past["step"]["scan"]) > 20


def steps_in(page: str) -> list[int]:
    """The steps that a saved page can play; test_drawn.py plays one in a browser."""
    (data,) = re.findall(r'id="saved">(.*?)</script>', page)
    saved = json.loads(data)
    past = json.loads(zlib.decompress(base64.b64decode(saved["past"])))
    assert saved["map"]["packed"]
    return [step for step, topic, _ in past if topic == "step"]


def reported(page: ClientConnection) -> dict[str, Any]:
    """The next message, drawn at once."""
    message: dict[str, Any] = json.loads(page.recv(PATIENCE_S))
    page.send('{"type": "drawn"}')
    return message


def answer_of(page: ClientConnection, topic: str) -> dict[str, Any]:
    """The requested topic; other messages that arrive meanwhile are unchanged."""
    while topic not in (message := reported(page)):
        pass
    answer: dict[str, Any] = message[topic]
    return answer


def finished(page: ClientConnection) -> dict[str, Any]:
    """All topics once the recording has been read to its end."""
    shown = reported(page)
    while shown["system"]["link"] != "finished":
        shown |= reported(page)
    return shown
