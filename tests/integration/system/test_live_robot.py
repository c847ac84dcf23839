"""A robot that is not ours: the example of docs/wire.md, run as it is printed there."""

import subprocess
import sys
from contextlib import closing
from pathlib import Path

import msgspec

from clustermcl.client import Client
from clustermcl.stack import Stack, meeting_in
from process_runtime.settings import BridgeSettings, CoordinatorSettings
from tests.integration.system.conftest import SMALL
from tests.integration.waiting import PATIENCE_S, patient_client, wait_until
from tests.integration.worlds import write_room

COORDINATOR = CoordinatorSettings(step_deadline_s=10.0, stale_after_s=10.0)
WIRE = Path(__file__).resolve().parents[3] / "docs" / "wire.md"


def example() -> str:
    page = WIRE.read_text()
    code = page.split("<!-- robot example -->\n```python\n")[1].split("```")[0]
    assert len(code.splitlines()) <= 34
    return code


def test_the_example_of_the_wire_page_drives_a_robot(short_folder: str) -> None:
    folder = Path(short_folder)
    bridge = BridgeSettings(map=str(write_room(folder)), source="zenoh")
    worker = msgspec.structs.replace(SMALL.worker, cache_folder=str(folder / "cache"))
    settings = meeting_in(
        folder,
        msgspec.structs.replace(SMALL, bridge=bridge, worker=worker, coordinator=COORDINATOR),
    )
    stack = Stack(settings, folder, logs_in_folder=True)
    with closing(stack):
        stack.start_all()
        with Client(patient_client(settings)) as client:
            wait_until(lambda: len(client.status().workers) == 4)
            wait_until(lambda: "sensor_bridge" in {p.sender for p in client.status().processes})
            robot = subprocess.run(
                [sys.executable, "-c", example(), settings.zenoh.router, "40"],
                capture_output=True, text=True, timeout=PATIENCE_S, check=False,
            )  # fmt: skip
            wait_until(lambda: client.status().steps_applied >= 9)
            status = client.status()
    assert robot.returncode == 0, robot.stderr
    assert "'schema': 'pose/1'" in robot.stdout
    assert "'freshness': 'fresh'" in robot.stdout
    # 40 readings, 0.05 m apart, a step each 0.2 m; the last scan still waits for odometry.
    assert status.steps_applied in (9, 10)
    assert status.steps_lost == 0
