"""The bridge's link to our own system: sends readings and commands, receives beliefs.

The only module that converts `outputs` to messages of the protocol.
"""

import math
import uuid
from collections.abc import Callable
from typing import TypeAlias

import numpy as np
import zenoh

from particle_filter.arrays import OCCUPIED
from protocol import keys
from protocol.answers import Configure, Relocalize, SetPose, Update
from protocol.arrays import ArrayBlob
from protocol.message import Message
from protocol.steps import LaserReading, MapReading, OdometryReading
from ros2_bridge.outputs import (
    GiveMap,
    GivePose,
    NoMotionUpdate,
    Reading,
    Reconfigure,
    SearchEverywhere,
)
from zenoh_link.wire import Asked, EventSink, Publisher, Received, ask_later, serve, subscribe

SUBSCRIBED = (keys.BELIEF, keys.ALL_REPORTS)

_COMMAND_TIMEOUT_S = 5.0

Command: TypeAlias = GivePose | SearchEverywhere | NoMotionUpdate | Reconfigure


class CoreLink:
    """The link to one robot's system.

    Args:
        session: with the robot's namespace.
        name: of this process.
        inbox: receives beliefs, reports and queries for the map.
    """

    def __init__(self, session: zenoh.Session, name: str, inbox: EventSink) -> None:
        self._session, self._name = session, name
        self._laser = Publisher(session, keys.LASER_READING)
        self._odometry = Publisher(session, keys.ODOMETRY_READING)
        self._maps = Publisher(session, keys.MAP_READING, may_wait=True)
        self._map: MapReading | None = None
        serve(session, keys.MAP_READING, inbox)
        for key in SUBSCRIBED:
            subscribe(session, key, inbox, key)

    def put(self, reading: Reading) -> None:
        match reading:
            case LaserReading():
                self._laser.put(reading)
            case OdometryReading():
                self._odometry.put(reading)

    def give_map(self, given: GiveMap) -> None:
        """Publish a map, and keep it for later queries."""
        grid_map = given.grid_map
        occupancy = np.where(grid_map.cells == OCCUPIED, np.int8(100), grid_map.cells)
        self._map = MapReading(
            sender=self._name,
            cell_m=grid_map.cell_m,
            map_from_grid=grid_map.map_from_grid,
            occupancy=ArrayBlob.of(occupancy, "int8"),
        )
        self._maps.put(self._map)

    def answer(self, asked: Asked) -> None:
        """Answer a query for the map."""
        if self._map is None:
            asked.refuse("no map has arrived yet")
        else:
            asked.answer(self._map)

    def command(
        self,
        command: Command,
        on_answer: Callable[[Received], object],
        on_failure: Callable[[str, str], object],
    ) -> None:
        """Send a command without waiting; one of the two functions is called, as by `ask`.

        Args:
            command: the command.
            on_answer: called with the encoded `CommandDone`.
            on_failure: called with the key and the reason.
        """
        key, message = self._message(command)
        self.ask(key, on_answer, lambda words: on_failure(key, words), message)

    def ask(
        self,
        key: str,
        on_answer: Callable[[Received], object],
        on_failure: Callable[[str], object],
        message: Message | None = None,
    ) -> None:
        """Query without waiting; one of the two functions is called on a thread of Zenoh."""
        ask_later(
            self._session,
            key,
            on_answer,
            on_failure,
            timeout_s=_COMMAND_TIMEOUT_S,
            message=message,
        )

    def _message(self, command: Command) -> tuple[str, Message]:
        name, command_id = self._name, uuid.uuid4().hex
        match command:
            case GivePose(map_from_robot=pose, covariance=covariance, stamp_ns=stamp_ns):
                return keys.SET_POSE, SetPose(
                    sender=name,
                    command_id=command_id,
                    map_from_robot=pose,
                    position_sigma_m=math.sqrt((covariance[0] + covariance[4]) / 2.0),
                    heading_sigma_rad=math.sqrt(covariance[8]),
                    covariance=covariance,
                    stamp_ns=stamp_ns,
                )
            case SearchEverywhere():
                return keys.RELOCALIZE, Relocalize(sender=name, command_id=command_id)
            case NoMotionUpdate():
                return keys.UPDATE, Update(sender=name, command_id=command_id)
            case Reconfigure(settings=settings):
                return keys.CONFIGURE, Configure(sender=name, settings=settings)
