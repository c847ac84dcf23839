"""The engine inside of the node: the library's filter in a thread, without Zenoh."""

import time
import uuid
from collections import Counter
from typing import Any

from msgspec.structs import replace

from clustermcl.belief.dead_reckoning import DeadReckoning
from clustermcl.belief.outcome import Outcome
from clustermcl.belief.pose_tracker import PoseTracker
from clustermcl.link.inbox import Inbox
from clustermcl.localizer import Belief, ClusterMCL
from clustermcl.protocol.answers import Configure, Relocalize, SetPose, Update
from clustermcl.protocol.causes import Cause
from clustermcl.protocol.errors import CommandRefusedError
from clustermcl.protocol.live_settings import AS_STARTED
from clustermcl.protocol.steps import LaserReading, MapReading, Observation, OdometryReading, Scan
from clustermcl.protocol.work import TrackReport
from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.recordings.maps.landmarks import landmarks_of_map, load_landmarks
from clustermcl.recordings.maps.map_file import load_map
from clustermcl.recordings.maps.map_message import from_reading
from clustermcl.ros2.port import Port
from clustermcl.ros2.sides import NO_ID, SENDER, Command, EngineStatus, Reading
from clustermcl.runtime.settings import Settings
from clustermcl.runtime.stop import StopFlag
from clustermcl.sensor_bridge.flow_control import FlowControl

_STATUS_EVERY_S, _CHANGES_EVERY_S, _POLL_S = 1.0, 5.0, 0.1
_LATE_S = 0.5
"""Readings that have waited for longer make no step: the filter has to catch up [s]."""
_QUEUED = {LaserReading: 100, OdometryReading: 1000, Observation: 100, MapReading: 1}


class _Localizer(ClusterMCL):
    """The library's localizer, which takes messages and calls a port."""

    _SNAPSHOT_EVERY_STEPS = 10

    def __init__(self, grid_map: GridMap, settings: Settings, port: Port) -> None:
        self._port, self.live = port, AS_STARTED
        self._shown = b""
        self._tracker = PoseTracker(
            "inside", settings.coordinator, DeadReckoning(settings.motion, settings.bridge)
        )
        self._flow, self._refused = FlowControl(settings.bridge.rate), Counter[Any]()
        super().__init__(grid_map, landmarks=grid_map.landmarks, settings=settings)

    def on_reading(self, reading: LaserReading | OdometryReading, *, is_late: bool) -> None:
        maker, now_ns = self._maker, time.monotonic_ns()
        is_laser = isinstance(reading, LaserReading)
        if is_laser and maker.stands and self._flow.wants_standing_step(now_ns):
            maker.gate.open_next()
        maker.gate.is_held = is_late
        scan = maker.on_reading(reading)
        self._count_refused(reading.stamp_ns)
        if maker.odometry is not None:
            self._odometry.add(*maker.odometry)
            self._tracker.odometry(*maker.odometry, now_ns)
        if scan is not None:
            self._flow.on_sent(scan.step, now_ns)
            self._tracker.scan(scan, now_ns)
            self._advanced(scan)
            self._tracker.weighed(scan)

    def on_observation(self, observation: Observation) -> None:
        self._maker.observe(observation)
        self._count_refused(observation.stamp_ns)

    def on_map(self, grid_map: GridMap) -> None:
        if grid_map.digest == self.map.digest:
            return
        before, keeps = self.belief, self._settings.coordinator.keep_pose_on_new_map
        self.change_map(grid_map, grid_map.landmarks)
        self._flow.on_new_map()
        self._port.on_new_map()
        if keeps and before is not None and before.state == "localized":
            at, stamp_ns = before.hypotheses[0], before.stamp_ns
            kept = SetPose(sender=SENDER, command_id=NO_ID, pose=at.pose, covariance=at.covariance)
            self.on_command(replace(kept, stamp_ns=stamp_ns, floor=at.floor))

    def on_command(self, command: Command) -> None:
        match command:
            case SetPose() | Relocalize():
                try:
                    self._carry_out(replace(command, command_id=uuid.uuid4().hex))
                except CommandRefusedError as error:
                    self._port.on_refused(Cause.COMMAND_REFUSED, str(error))
            case Update():
                self._maker.gate.open_next()
            case Configure(settings=live):
                self.live = live
                self._maker.configure(live)

    def show_changes(self) -> None:
        """Give the listener what has changed in the building, if that is new."""
        changes = self.changes()
        cells = changes.cells.array()[:, :2].tobytes()
        if cells != self._shown:
            self._shown = cells
            self._port.on_changes(changes)

    def status(self) -> EngineStatus:
        found = self._tracker.answer(time.monotonic_ns(), workers=1)
        return EngineStatus(found.state, found.freshness, found.step, 1, self.live)

    def _set_belief(self, outcome: Outcome, scan: Scan) -> Belief:
        belief = super()._set_belief(outcome, scan)
        self._tracker.believed(outcome, scan.odom_from_robot)
        searching = belief.state == "searching"
        self._flow.on_belief(belief.step, belief.term, time.monotonic_ns(), searching=searching)
        for report in self._filter.reports:
            if isinstance(report, TrackReport) and report.snapshot and report.cluster is not None:
                self._port.on_particles(report.cluster, report.snapshot)
        self._port.on_belief(belief)
        return belief

    def _count_refused(self, stamp_ns: int) -> None:
        dropped = self._maker.dropped
        if dropped != self._refused:
            for cause in (dropped - self._refused).elements():
                detail = dropped.details.get(cause, f"stamp {stamp_ns} ns")
                self._port.on_refused(cause, detail)
            self._refused = Counter(dropped)


class InsideEngine:
    """Runs the filter in the thread that calls `run`; other methods may be called in any thread."""

    def __init__(self, settings: Settings, port: Port) -> None:
        self._settings, self._port = settings, port
        self._localizer: _Localizer | None = None
        self._waiting: list[Command] = []
        """Commands from before the map."""
        self._inbox: Inbox[tuple[float, Reading | Command | None]] = Inbox({})
        for kind, count in _QUEUED.items():
            self._inbox.keep(kind.__name__, count)

    def put(self, reading: Reading) -> None:
        self._inbox.put_newest(type(reading).__name__, (time.monotonic(), reading))

    def command(self, command: Command) -> None:
        self._inbox.put_own((time.monotonic(), command))

    def ask_advice(self) -> None:
        self._inbox.put_own((time.monotonic(), None))

    def run(self, stop: StopFlag) -> None:
        """Localize until `stop` is set."""
        if (file := self._settings.bridge.map) and file != "zenoh":
            grid_map = load_map(file)
            self._on_map(grid_map.with_landmarks(landmarks_of_map(file, grid_map.floors)))
        status_s = changes_s = 0.0
        while not stop.is_set():
            if (arrived := self._inbox.get(_POLL_S)) is not None:
                self._on_event(*arrived)
            if (now_s := time.monotonic()) >= status_s:
                status_s = now_s + _STATUS_EVERY_S
                known = None if self._localizer is None else self._localizer.status()
                self._port.on_status(known)
            if self._localizer is not None and now_s >= changes_s:
                changes_s = now_s + _CHANGES_EVERY_S
                self._localizer.show_changes()

    def _on_event(self, arrived_s: float, event: Reading | Command | None) -> None:
        localizer = self._localizer
        match event:
            case MapReading():
                grid_map = from_reading(event)
                if file := self._settings.bridge.landmarks:
                    grid_map = grid_map.with_landmarks(load_landmarks(file))
                self._on_map(grid_map)
            case LaserReading() | OdometryReading() | Observation() if localizer is None:
                self._port.on_refused(Cause.BEFORE_MAP, f"stamp {event.stamp_ns} ns")
            case LaserReading() | OdometryReading():
                assert localizer is not None
                is_late = time.monotonic() - arrived_s > _LATE_S
                localizer.on_reading(event, is_late=is_late)
            case Observation():
                assert localizer is not None
                localizer.on_observation(event)
            case None if localizer is not None:
                self._port.on_advice(localizer.advice())
            case None:
                self._port.on_refused(Cause.NO_ADVICE, "no map has arrived yet")
            case _ if localizer is None:
                self._waiting.append(event)
            case _:
                localizer.on_command(event)

    def _on_map(self, grid_map: GridMap) -> None:
        try:
            if self._localizer is not None:
                self._localizer.on_map(grid_map)
                return
            self._localizer = _Localizer(grid_map, self._settings, self._port)
        except ValueError as error:
            self._port.on_refused(Cause.MAP_REFUSED, str(error))
            return
        for command in self._waiting:
            self._localizer.on_command(command)
        self._waiting.clear()
