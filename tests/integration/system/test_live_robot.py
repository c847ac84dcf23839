"""A robot that is not ours: the example of docs/wire.md, run as it is printed there."""

import subprocess
import sys
from pathlib import Path

import msgspec

from clustermcl.runtime.settings import BridgeSettings, CoordinatorSettings
from tests.integration.faults.system import system
from tests.integration.system.conftest import SMALL
from tests.integration.waiting import PATIENCE_S, wait_until
from tests.integration.worlds import write_room

COORDINATOR = CoordinatorSettings(step_deadline_s=10.0, stale_after_s=10.0)
WIRE = Path(__file__).resolve().parents[3] / "docs" / "wire.md"


def example() -> str:
    page = WIRE.read_text()
    code = page.split("<!-- robot example -->\n```python\n")[1].split("```")[0]
    assert len(code.splitlines()) <= 34
    return code


def test_the_example_of_the_wire_page_drives_a_robot(tmp_path: Path) -> None:
    bridge = BridgeSettings(map=str(write_room(tmp_path)), source="zenoh")
    settings = msgspec.structs.replace(SMALL, bridge=bridge, coordinator=COORDINATOR)
    with system(settings) as tested, tested.client as client:
        wait_until(lambda: len(client.status().workers) == 4)
        wait_until(lambda: "sensor_bridge" in {p.sender for p in client.status().processes})
        robot = subprocess.run(
            [sys.executable, "-c", example(), tested.settings.zenoh.router, "40"],
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
