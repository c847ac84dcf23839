import signal
from collections import Counter
from pathlib import Path

from clustermcl.recordings.recording import open_recording
from clustermcl.runtime.settings import BridgeSettings
from clustermcl.sensor_bridge.recorded import steps_of
from tests.integration.faults.system import system
from tests.integration.system.commands import typed
from tests.integration.waiting import wait_until
from tests.unit.recordings.test_run_log import as_others_read

IN_FLIGHT = 5
"""Steps that may be published and not yet decided."""


def counts_in(file: Path) -> Counter[str]:
    return Counter({topic: len(found) for topic, found in as_others_read(file).items()})


def steps_in(file: Path) -> int:
    """How many steps the system would make of it."""
    settings = BridgeSettings()
    return sum(1 for _ in steps_of(open_recording(file, settings), settings, ""))


def test_a_running_system_is_recorded_until_ctrl_c(tmp_path: Path) -> None:
    file = tmp_path / "run.mcap"
    with system() as tested:
        tested.wait_for_steps(3)
        endpoint = f"zenoh.router={tested.settings.zenoh.router}"
        words = ("record", str(file), "--set", endpoint)
        with typed(*words, folder=tmp_path) as recording:
            wait_until(file.exists)
            wait_until(lambda: file.stat().st_size > 0)
            tested.wait_for_steps(10 + IN_FLIGHT)
            assert recording.end(signal.SIGINT) == 0, recording.err
            output = recording.out
    steps = int(output.split()[-2])
    assert output == f"{file}: {steps} steps\n"
    counts = counts_in(file)
    assert steps >= 9
    assert (counts["/map"], counts["/scan"]) == (1, steps)
    assert counts["/tf"] > 5 * steps, "odometry between the steps"
    assert abs(steps - counts["/places"]) <= IN_FLIGHT, "some at either end"
    assert steps_in(file) == steps
