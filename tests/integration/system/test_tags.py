import tempfile
import time
from itertools import islice
from pathlib import Path

import msgspec
import numpy as np
import yaml

from clustermcl.stack import COORDINATOR
from process_runtime.settings import BridgeSettings
from protocol import keys
from protocol.answers import Belief, Status
from protocol.codec import encode
from protocol.health import Health
from protocol.steps import Observation, OdometryReading
from robot_simulator.simulation import Simulation
from tests.integration.faults.live_robot import BRIDGE, PACE
from tests.integration.faults.system import SMALL, system
from tests.integration.waiting import wait_until
from tests.maps import write_map
from tests.unit.clustermcl.tags import CROSS, SIGMA_M, TAGS, is_right, sight
from zenoh_link.wire import Publisher

SEED = 3
"""This robot sees a tag within its first steps."""


def test_a_tag_distinguishes_equal_arms() -> None:
    with tempfile.TemporaryDirectory(prefix="mcl-tags-") as name:
        folder = Path(name)
        map_file = write_map(CROSS.map, folder, "map")
        entries = [{"id": tag.name, "x": tag.x, "y": tag.y, "sigma": tag.sigma} for tag in TAGS]
        (folder / "landmarks.yaml").write_text(yaml.safe_dump({"landmarks": entries}))
        bridge = BridgeSettings(map=str(map_file), source="zenoh")
        with system(msgspec.structs.replace(SMALL, bridge=bridge)) as tested:
            wait_until(lambda: "coordinator ready" in tested.log(COORDINATOR))
            odometry = Publisher(tested.session, keys.ODOMETRY_READING)
            laser = Publisher(tested.session, keys.LASER_READING)
            eye = Publisher(tested.session, keys.OBSERVATION_READING)
            rng, zero_ns, truth = np.random.default_rng(SEED), time.time_ns(), {}
            for tick in islice(Simulation(CROSS, SEED), 150):
                for reading in tick.readings:
                    stamp_ns = zero_ns + reading.stamp_ns // PACE
                    time.sleep(max(stamp_ns - time.time_ns(), 0) / 1e9)
                    stamped = msgspec.structs.replace(reading, stamp_ns=stamp_ns)
                    if isinstance(stamped, OdometryReading):
                        odometry.put(stamped)
                        continue
                    truth[stamp_ns] = tick
                    if (seen := sight(tick, rng)) is not None:
                        eye.put(observation(seen, stamp_ns))
                        tested.session.put(
                            keys.OBSERVATION_READING, encode(observation(("none", seen[1]), 1))
                        )
                    laser.put(stamped)
            tested.session.put(keys.OBSERVATION_READING, b"\xc1")

            def sure() -> list[Belief]:
                return [belief for belief in tested.since(0) if belief.state == "localized"]

            wait_until(lambda: len(sure()) > 5)
            wrong = [each.step for each in sure() if not is_right(each, truth[each.stamp_ns])]
            assert wrong == []
            with tested.client as client:
                refused = {
                    "reading refused: unknown landmark",
                    "malformed Observation: not MessagePack",
                }
                wait_until(lambda: refused <= set(dropped(client.status())))
                sources = bridge_of(client.status()).sources
                assert [source.name for source in sources] == ["eye north"]  # it sees no other
                assert sources[0].broken_probability < 0.1


def observation(seen: tuple[str, np.ndarray], stamp_ns: int) -> Observation:
    name, position = seen
    return Observation(
        sender="eye",
        stamp_ns=stamp_ns,
        landmark=name,
        mean=tuple(position.tolist()),
        covariance=(SIGMA_M**2, 0.0, 0.0, SIGMA_M**2),
    )


def dropped(status: Status) -> dict[str, int]:
    """The bridge's counters of dropped messages, by cause."""
    return dict(bridge_of(status).dropped)


def bridge_of(status: Status) -> Health:
    """The health of the bridge."""
    (health,) = (health for health in status.processes if health.sender == BRIDGE)
    return health
