"""Stands in for bridge, coordinator and workers: receives readings and commands, publishes
beliefs."""

from typing import Any

import msgpack
import msgspec
import numpy as np
import zenoh
from numpy.typing import NDArray

from clustermcl.protocol import keys
from clustermcl.protocol.advice import Advice
from clustermcl.protocol.answers import CommandDone, State, Status
from clustermcl.protocol.codec import decode, encode
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import LaserReading, MapReading, Observation, OdometryReading
from clustermcl.protocol.work import TrackReport
from tests.integration.waiting import answered
from tests.unit.evaluation.places import STATUS
from tests.unit.ros2.beliefs import belief


class SystemDouble:
    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self.lasers: list[LaserReading] = []
        self.odometry: list[OdometryReading] = []
        self.observations: list[Observation] = []
        self.maps: list[tuple[NDArray[np.int8], float, PoseTuple]] = []
        """Cells as ROS has them, side of a cell, origin."""
        self.commands: list[tuple[str, dict[str, Any]]] = []
        self.freshness = "fresh"
        self.advice = Advice(sender="coordinator", note="there is no belief yet")
        self.state: State = "searching"
        self._step = 0
        session.declare_subscriber(keys.LASER_READING, self._on_laser)
        session.declare_subscriber(keys.ODOMETRY_READING, self._on_odometry)
        session.declare_subscriber(keys.OBSERVATION_READING, self._on_observation)
        session.declare_subscriber(keys.MAP_READING, self._on_map)
        for key in (keys.SET_POSE, keys.RELOCALIZE, keys.UPDATE, keys.STATUS, keys.ADVICE):
            session.declare_queryable(key, self._on_query, complete=True)

    def believe(
        self,
        stamp_ns: int,
        *places: tuple[int, float, PoseTuple],
        state: State = "ambiguous",
        term: int = 1,
    ) -> None:
        self.state = state
        reported = belief(stamp_ns, *places, state=state, term=term)
        self._step += 1
        reported = msgspec.structs.replace(reported, step=self._step)
        self._session.put(keys.BELIEF, encode(reported))

    def report(self, report: TrackReport) -> None:
        self._session.put("worker/worker-0/report", encode(report))

    def ask_for_map(self) -> PoseTuple:
        """Ask the robot for its map, as a bridge does that comes later; its origin."""
        return answered(self._session, keys.MAP_READING, MapReading).map_from_grid

    def put(self, key: str, payload: bytes) -> None:
        self._session.put(key, payload)

    def _on_laser(self, sample: zenoh.Sample) -> None:
        self.lasers.append(decode(sample.payload.to_bytes(), LaserReading))

    def _on_odometry(self, sample: zenoh.Sample) -> None:
        self.odometry.append(decode(sample.payload.to_bytes(), OdometryReading))

    def _on_observation(self, sample: zenoh.Sample) -> None:
        self.observations.append(decode(sample.payload.to_bytes(), Observation))

    def _on_map(self, sample: zenoh.Sample) -> None:
        reading = map_in(sample.payload.to_bytes())
        self.maps.append((reading.occupancy.array(), reading.cell_m, reading.map_from_grid))

    def _on_query(self, query: zenoh.Query) -> None:
        key = str(query.key_expr)
        with query:
            if key == keys.STATUS:
                query.reply(key, encode(self._status()))
                return
            if key == keys.ADVICE:
                query.reply(key, encode(self.advice))
                return
            assert query.payload is not None
            self.commands.append((key, msgpack.unpackb(query.payload.to_bytes())))
            query.reply(key, encode(CommandDone(sender="coordinator")))

    def _status(self) -> Status:
        return msgspec.structs.replace(
            STATUS, state=self.state, freshness=self.freshness, step=self._step, processes=()
        )


def map_in(payload: bytes) -> MapReading:
    return msgspec.convert(msgpack.unpackb(payload), MapReading)
