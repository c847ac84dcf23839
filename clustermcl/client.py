"""The Python client of a running system: queries and commands."""

from __future__ import annotations  # `help` shows names of types, not their definitions

import os
import time
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Self, TypeVar

import zenoh

from clustermcl.link.access_control import doubt_of_certificate, roles_that_ask
from clustermcl.link.inbox import Inbox
from clustermcl.link.session import open_session, refuse_forked
from clustermcl.link.wire import Events, Received, ask, subscribe
from clustermcl.protocol import keys
from clustermcl.protocol.advice import Advice
from clustermcl.protocol.answers import (
    Belief,
    CommandDone,
    Hypotheses,
    Kidnap,
    PoseAnswer,
    Relocalize,
    SetPose,
    Status,
    Update,
)
from clustermcl.protocol.changes import Changes
from clustermcl.protocol.codec import decode
from clustermcl.protocol.errors import ClusterMclError, CommandRefusedError, UnreachableError
from clustermcl.protocol.job_events import JobEvents
from clustermcl.protocol.message import Message, PoseTuple
from clustermcl.protocol.pose_arrays import checked_pose
from clustermcl.protocol.steps import MapMessage
from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.recordings.maps.map_message import from_message
from clustermcl.robot_commands import RobotCommands, new_id
from clustermcl.runtime.caller import caller
from clustermcl.runtime.settings import ROBOT_VARIABLE, ROUTER_VARIABLE, Settings
from clustermcl.runtime.settings_file import with_setting
from clustermcl.runtime.stop import StopFlag

A = TypeVar("A", bound=Message)

_PAUSE_S = 0.1
_POLL_S = 0.1
_KEPT_MESSAGES = 256


class NotLocalizedError(ClusterMclError):
    """The robot was not localized in time; `answer` is the last answer to the query."""

    def __init__(self, *, answer: PoseAnswer, waited_s: float) -> None:
        self.answer, self.waited_s = answer, waited_s
        super().__init__(
            f"not localized within {waited_s:g} s: {answer.state}, {answer.freshness}, "
            f"probability {answer.probability:.2f}"
        )


class Client(RobotCommands):
    """A connection to the system of one robot; use it in a ``with`` block.

        with Client(robot="r1") as client:
            print(client.pose().pose)

    Queries and commands are repeated until they are answered or time out; the system carries out
    a repeated command only once. `timeout_s` of a method limits the wait for an answer, or for each
    belief [s]. Use a client in one thread at a time; an asyncio program calls its methods by
    ``asyncio.to_thread``. Once a process has connected, start children that connect by
    ``multiprocessing.get_context("spawn")``.

    Args:
        settings: the router's endpoint, the robot's name, certificates, time-outs. None: the
            defaults, with `CLUSTERMCL_ROBOT` and `CLUSTERMCL_ROUTER` of the environment.
        robot: the robot's name, instead of that in the settings.
        router: the router's endpoint, such as ``tcp/192.168.1.10:7447``, instead of that in the
            settings.
        timeout_s: limit for connecting, and for each query and command [s]. None:
            `zenoh.connect_timeout_s` and `zenoh.query_timeout_s` of the settings.
        stop: flag that ends a wait with `StoppedError`; None: waits cannot be ended.

    Raises:
        SettingsError: a name, an endpoint or a time-out is invalid.
    """

    def __init__(
        self,
        settings: Settings | None = None,
        *,
        robot: str | None = None,
        router: str | None = None,
        timeout_s: float | None = None,
        stop: StopFlag | None = None,
    ) -> None:
        if settings is None:
            settings = Settings()
            robot = robot or os.environ.get(ROBOT_VARIABLE)
            router = router or os.environ.get(ROUTER_VARIABLE)
        for name, value in (
            ("robot.name", robot),
            ("zenoh.router", router),
            ("zenoh.connect_timeout_s", timeout_s),
            ("zenoh.query_timeout_s", timeout_s),
        ):
            if value is not None:
                settings = with_setting(settings, name, value, "Client")
        self._settings = settings
        self._stop = stop or StopFlag()
        self._resources = ExitStack()
        self._open: zenoh.Session | None = None
        self._deadline_s = 0.0

    def __enter__(self) -> Self:
        """Connect to the router.

        Raises:
            UnreachableError: no router answers in time.
            SettingsError: the endpoint or the robot's name is invalid.
            RuntimeError: this process was forked by one that had connected.
        """
        zenoh_settings, robot = self._settings.zenoh, self._settings.robot
        within_s = zenoh_settings.connect_timeout_s
        self._deadline_s = time.monotonic() + within_s  # for connecting and the first answers
        self._open = self._resources.enter_context(
            open_session(zenoh_settings, robot, self._stop, wait_s=within_s)
        )
        return self

    def __exit__(self, *_error: object) -> None:
        self._open = None
        self._resources.close()

    def pose(self) -> PoseAnswer:
        """Return the robot's present pose.

        Raises:
            UnreachableError: no answer arrived in time. All queries and commands raise this error.
        """
        return self._ask(keys.POSE, PoseAnswer)

    def hypotheses(self) -> Hypotheses:
        """Return all places where the robot may be, the most probable first."""
        return self._ask(keys.HYPOTHESES, Hypotheses)

    def advice(self, *, timeout_s: float = 20.0) -> Advice:
        """Return ways for the robot to drive so that scans distinguish its possible places."""
        return self._ask(keys.ADVICE, Advice, timeout_s=timeout_s)

    def events(self) -> JobEvents:
        """Return the newest events of clusters and searches, oldest first."""
        return self._ask(keys.EVENTS, JobEvents)

    def status(self) -> Status:
        """Return the system's state, processes and counters."""
        return self._ask(keys.STATUS, Status)

    def map(self, *, timeout_s: float = 30.0) -> GridMap:
        """Return the map in which all poses are given.

        Raises:
            MalformedMessageError: the answer is not a map, or its digest is wrong.
        """
        return from_message(self._ask(keys.MAP, MapMessage, timeout_s=timeout_s))

    def changes(self, *, timeout_s: float = 30.0) -> Changes:
        """Return what has changed since the building was mapped, as the robot has seen it."""
        return self._ask(keys.CHANGES, Changes, timeout_s=timeout_s)

    def update(self) -> None:
        """Use the next scan for a step, even if the robot stands still."""
        self._carry_out(Update(sender=caller(), command_id=new_id()))

    def kidnap(self, pose: PoseTuple | None = None) -> None:
        """Move the simulated robot without letting its odometry show the motion.

        Args:
            pose: the new pose: x [m], y [m], heading [rad]; None: a random pose far away.
        """
        there = None if pose is None else checked_pose("pose", pose)
        self._carry_out(Kidnap(sender=caller(), command_id=new_id(), pose=there))

    def wait_until_localized(self, timeout_s: float = 60.0) -> PoseAnswer:
        """Wait until the robot is localized and its pose is fresh, then return the pose.

        Raises:
            NotLocalizedError: the robot was not localized in time.
            StoppedError: the client's stop flag was set.
        """
        deadline_s = time.monotonic() + timeout_s
        while True:
            answer = self.pose()
            if (answer.state, answer.freshness) == ("localized", "fresh"):
                return answer
            if time.monotonic() >= deadline_s:
                raise NotLocalizedError(answer=answer, waited_s=timeout_s)
            self._stop.wait(_PAUSE_S)
            self._stop.check()

    def beliefs(self, *, timeout_s: float | None = None) -> Iterator[Belief]:
        """Yield each new belief, without end.

        While the robot stands still, there are none. Of more than 256 unread beliefs, the oldest
        are dropped. Beliefs of a replaced coordinator are skipped.

        Raises:
            UnreachableError: no coordinator answers, or no belief arrived in time.
            StoppedError: the client's stop flag was set.
        """
        self.pose()  # raises if there is no robot
        published = self.published(keys.BELIEF, Belief, timeout_s)

        def of_newest_term() -> Iterator[Belief]:
            term = 0
            for belief in published:
                if belief.term >= term:
                    term = belief.term
                    yield belief

        return of_newest_term()

    def published(self, key: str, kind: type[A], timeout_s: float | None = None) -> Iterator[A]:
        """Subscribe, until the iterator is dropped; yield each message on the key.

        Raises:
            UnreachableError: no message arrived in time.
            StoppedError: the client's stop flag was set.
            ValueError: the client was closed.
        """
        inbox: Events = Inbox({key: _KEPT_MESSAGES})
        session = self._session
        subscriber = subscribe(session, key, kind, inbox, key)

        def decoded() -> Iterator[A]:
            received_s = time.monotonic()
            with subscriber:
                while self._session is session:
                    self._stop.check()
                    event = inbox.get(_POLL_S)
                    if isinstance(event, Received):
                        yield decode(event.payload, kind)
                        received_s = time.monotonic()
                    elif timeout_s is not None and time.monotonic() - received_s > timeout_s:
                        raise UnreachableError(
                            peer="coordinator",
                            endpoint=self._settings.zenoh.router,
                            waited_s=timeout_s,
                            problem=f"robot {self._settings.robot.name!r} published nothing on "
                            f"{key!r} for {timeout_s:g} s: does it stand still, or has it ended?",
                        )

        return decoded()

    @property
    def _session(self) -> zenoh.Session:
        if self._open is None:
            raise ValueError("the client is not connected: use it in a with block")
        refuse_forked()
        return self._open

    def _carry_out(self, command: SetPose | Relocalize | Update | Kidnap) -> None:
        done = self._ask(command.key, CommandDone, command)
        if done.problem:
            raise CommandRefusedError(command=command.key, problem=done.problem)

    def _ask(
        self,
        key: str,
        answer: type[A],
        message: Message | None = None,
        timeout_s: float | None = None,
    ) -> A:
        """Repeat a query until it is answered, and return the answer.

        Just after connecting, the router may have no route yet to the process that answers.
        """
        settings = self._settings.zenoh
        asked_s = time.monotonic()
        deadline_s = max(self._deadline_s, asked_s + settings.query_timeout_s)
        while True:
            left_s = deadline_s - time.monotonic()
            within_s = min(settings.query_timeout_s, max(left_s, _PAUSE_S))
            try:
                return ask(
                    self._session, key, answer, timeout_s=timeout_s or within_s, message=message
                )
            except UnreachableError as error:
                now_s = time.monotonic()
                if now_s + _PAUSE_S >= deadline_s:
                    raise self._unreachable(key, now_s - asked_s, error) from error
            self._stop.wait(_PAUSE_S)
            self._stop.check()

    def _unreachable(self, key: str, waited_s: float, error: UnreachableError) -> UnreachableError:
        bridges = dict.fromkeys((keys.MAP, keys.UPDATE, keys.CHANGES), "bridge")
        peer = ({keys.KIDNAP: "simulator"} | bridges).get(key, "coordinator")
        router, robot = self._settings.zenoh.router, self._settings.robot.name
        problem = (
            f"no {peer} of robot {robot!r} answers at {router} ({error}): "
            "start one with 'clustermcl up', or name another robot or router"
        )
        if certificate := self._settings.zenoh.tls_certificate:
            doubt = doubt_of_certificate(certificate, roles_that_ask(key), "", robot)
            hint = f"{certificate} may not ask for {key!r} where access is controlled: {doubt}"
            problem = f"{hint}; or {problem}" if doubt else problem
        return UnreachableError(peer=peer, endpoint=router, waited_s=waited_s, problem=problem)
