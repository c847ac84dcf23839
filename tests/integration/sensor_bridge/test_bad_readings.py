from pathlib import Path

import msgspec

from clustermcl.protocol.steps import Reading
from clustermcl.recordings.maps.map_file import load_map
from clustermcl.runtime.settings import BridgeSettings
from clustermcl.sensor_bridge.step_maker import StepMaker
from tests.integration.sensor_bridge.conftest import StartBridge
from tests.integration.system.rubbish import bad_readings
from tests.integration.worlds import write_room
from tests.unit.recordings.logs import laser_reading, odometry_reading

CAUSES = {
    f"reading refused: {cause}"
    for cause in (
        "not finite", "no returns", "no beams", "too many beams", "bad geometry", "malformed",
        "outlier in time or place", "stamp steps back",
    )
}  # fmt: skip


def quiet_drive() -> list[Reading]:
    """A metre a second, ten scans a second, each with odometry of its time: so scans and odometry
    may change places on their way and give the same steps.
    """
    drive: list[Reading] = []
    for tick in range(20):
        drive.append(laser_reading(tick / 10))
        drive.append(odometry_reading(tick / 10, (tick / 10, 0.0, 0.0)))
    return drive


def test_rubbish_among_readings_changes_no_step(start_bridge: StartBridge, tmp_path: Path) -> None:
    map_file = write_room(tmp_path)
    robot = start_bridge(map_file)
    for number, reading in enumerate(quiet_drive()):
        robot.publish(reading)
        if number % 10 == 5:
            robot.wait_until_taken()
            at_s = reading.stamp_ns / 1e9
            odometry = odometry_reading(at_s, (at_s, 0.0, 0.0))
            for key, data in bad_readings(laser_reading(at_s), odometry):
                robot.put(key, data)
            robot.wait_until_taken()
    robot.wait_until_taken()
    assert (robot.dropped() or {}).keys() >= CAUSES
    assert "odometry jumped" not in (robot.dropped() or {})
    maker = StepMaker(BridgeSettings(), load_map(map_file).digest, "sensor_bridge", live=True)
    published = [msgspec.structs.replace(step, remarks=()) for step in robot.steps()]
    assert published == [step for step in map(maker.on_reading, quiet_drive()) if step]
