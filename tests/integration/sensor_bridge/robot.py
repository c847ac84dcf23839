"""The real bridge, and a robot that publishes readings and asks what was made of them."""

from collections.abc import Iterator
from contextlib import contextmanager

import zenoh

from clustermcl.link.inbox import Inbox
from clustermcl.link.wire import Events, Received, subscribe
from clustermcl.protocol import keys
from clustermcl.protocol.codec import decode, encode
from clustermcl.protocol.health import Health
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import LaserReading, MapReading, Reading, Scan, ScanHistory
from tests.integration.processes import RunningProcess
from tests.integration.waiting import answered, wait_until
from tests.unit.recordings.logs import laser_reading, odometry_reading

NOT_READ = (
    "reading before the map",
    "malformed LaserReading: field",
    "malformed OdometryReading: field",
)


@contextmanager
def answering(session: zenoh.Session, reading: MapReading) -> Iterator[None]:
    """Answer queries for the map, as a robot does that published it earlier."""

    def answer(query: zenoh.Query) -> None:
        with query:
            query.reply(keys.MAP_READING, encode(reading))

    queryable = session.declare_queryable(keys.MAP_READING, answer, complete=True)
    yield
    queryable.undeclare()


class Robot:
    def __init__(self, session: zenoh.Session, bridge: RunningProcess | None = None) -> None:
        self._session, self.bridge, self._readings = session, bridge, 0
        self._inbox: Events = Inbox({"health": 10})
        self._health: Health | None = None
        subscribe(session, keys.BRIDGE_HEALTH, Health, self._inbox, "health")

    def publish(self, reading: Reading) -> None:
        is_laser = isinstance(reading, LaserReading)
        self.put(keys.LASER_READING if is_laser else keys.ODOMETRY_READING, encode(reading))

    def wait_until_taken(self) -> None:
        """Wait until the bridge says that it has taken all readings, as it does once a second.

        An answer does not show it: each key has a thread of its own in the bridge.
        """

        def is_taken() -> bool:
            dropped = self.dropped() or {}
            done = self._health.done if self._health else {}
            taken = done.get("scans", 0) + done.get("odometry", 0)
            return taken + sum(dropped.get(cause, 0) for cause in NOT_READ) >= self._readings

        wait_until(is_taken)

    def steps(self) -> list[Scan]:
        return list(answered(self._session, keys.scan_history(0, None), ScanHistory).scans)

    def put(self, key: str, data: bytes) -> None:
        self._readings += key in (keys.LASER_READING, keys.ODOMETRY_READING)
        self._session.put(key, data, congestion_control=zenoh.CongestionControl.BLOCK)

    def dropped(self) -> dict[str, int] | None:
        """What the bridge said last that it dropped; None before its first word."""
        while (event := self._inbox.get(0.0)) is not None:
            assert isinstance(event, Received)
            self._health = decode(event.payload, Health)
        return self._health.dropped if self._health else None


class Standing:
    """Sends a scan and the odometry after it, a tenth of a second apart."""

    def __init__(self, robot: Robot) -> None:
        self._robot, self._tick = robot, 0

    def scan(self, pose: PoseTuple = (1.0, 2.0, 0.5)) -> None:
        self._robot.publish(odometry_reading(self._tick / 10, pose))
        self._robot.publish(laser_reading(self._tick / 10 + 0.01, pose))
        self._robot.wait_until_taken()
        self._tick += 1
