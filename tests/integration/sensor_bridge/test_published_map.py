from pathlib import Path

import msgspec
import numpy as np
import pytest

from clustermcl.client import Client
from clustermcl.link import configuration
from clustermcl.protocol import keys
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.codec import encode
from clustermcl.protocol.message import LARGEST_BYTES
from clustermcl.protocol.steps import MapReading
from clustermcl.recordings.maps.landmarks import load_landmarks
from clustermcl.recordings.maps.map_message import from_reading
from clustermcl.runtime.settings import Settings, ZenohSettings
from tests.integration.conftest import OpenClient
from tests.integration.sensor_bridge.conftest import StartBridge
from tests.integration.sensor_bridge.robot import Standing, answering
from tests.integration.waiting import wait_until


def a_map(width_m: float) -> MapReading:
    occupancy = np.zeros((40, int(10 * width_m)), np.int8)
    occupancy[[0, -1], :] = occupancy[:, [0, -1]] = 100
    return MapReading(
        sender="robot", cell_m=0.1, map_from_grid=(0.0, 0.0, 0.0),
        occupancy=ArrayBlob.of(occupancy, "int8"),
    )  # fmt: skip


FIRST, SECOND = a_map(6.0), a_map(9.0)
NO_MAPS = (
    b"rubbish",
    encode(msgspec.structs.replace(FIRST, occupancy=ArrayBlob.of(np.zeros((0, 0)), "int8"))),
    encode(msgspec.structs.replace(FIRST, cell_m=-1.0)),
    bytes(LARGEST_BYTES + 1),
)


@pytest.fixture(autouse=True)
def patient_links(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the robot and the router: the largest message takes more than 0.3 s on a busy machine, and
    the link would be closed over it."""
    monkeypatch.setattr(configuration, "_WAIT_BEFORE_CLOSE_US", 20_000_000)


def test_a_bridge_asks_for_the_map_follows_another_and_counts_invalid_ones(
    start_bridge: StartBridge, router: ZenohSettings, open_client: OpenClient, tmp_path: Path
) -> None:
    file = tmp_path / "tags.yaml"
    file.write_text("landmarks: [{id: tag, x: 1, y: 2}]")
    tags = load_landmarks(file)
    first, second = (from_reading(each).with_landmarks(tags).digest for each in (FIRST, SECOND))
    robot = start_bridge(landmarks=file)
    standing = Standing(robot)
    standing.scan()
    assert robot.steps() == [], "there is no map yet"
    with Client(Settings(zenoh=router)) as client:
        with answering(open_client(), FIRST):
            assert client.map().digest == first
        for _ in range(2):
            standing.scan()
        assert [step.map_digest for step in robot.steps()] == [first]
        robot.put(keys.MAP_READING, encode(SECOND))
        wait_until(lambda: client.map().digest == second)
        assert client.map().landmarks == tags
    causes = {
        "malformed MapReading: not MessagePack",
        "malformed map: impossible",
        "dropped map too large",
    }

    def refused() -> int:
        return sum(count for cause, count in (robot.dropped() or {}).items() if cause in causes)

    for number, data in enumerate(NO_MAPS, start=1):
        robot.put(keys.MAP_READING, data)
        wait_until(lambda number=number: refused() == number)  # the inbox keeps one map
    assert (robot.dropped() or {}).keys() >= causes
    standing.scan()
    (step,) = robot.steps()
    assert (step.step, step.map_digest) == (1, second)
