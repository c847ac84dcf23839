"""The sensor bridge process: readings of a robot or a recording become numbered steps."""

import logging
import math
import time
from collections import Counter, deque
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import TypeAlias

from msgspec.structs import replace

from clustermcl.link.node import Node
from clustermcl.link.wire import Asked, Received, Token, ask, is_alive
from clustermcl.protocol import errors, keys, steps
from clustermcl.protocol.answers import Belief, CommandDone, Configure, Status, Update
from clustermcl.protocol.causes import AnyCause, Cause
from clustermcl.protocol.codec import decode
from clustermcl.protocol.live_settings import AS_STARTED, LiveSettings
from clustermcl.protocol.message import MAX_SCAN_STEP
from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.recordings.maps.landmarks import landmarks_of_map, load_landmarks
from clustermcl.recordings.maps.map_file import load_map, map_file_of
from clustermcl.recordings.maps.map_message import from_reading, to_message
from clustermcl.runtime import sources
from clustermcl.runtime.folders import state_folder
from clustermcl.runtime.main import Invocation, process_main
from clustermcl.runtime.settings import BridgeSettings
from clustermcl.sensor_bridge.building_changes import BuildingChanges
from clustermcl.sensor_bridge.flow_control import FlowControl
from clustermcl.sensor_bridge.recorded import Source, recorded_source
from clustermcl.sensor_bridge.refused import Refused
from clustermcl.sensor_bridge.step_maker import StepMaker

POLL_S = 0.1
WAIT_S = 5.0
"""A robot that has published nothing this long after the start is reported [s]."""
ASK_MAP_EVERY_S = 1.0
STATUS_TIMEOUT_S = 5.0
"""Time-out of querying a busy coordinator; without a coordinator the query fails at once [s]."""
KEPT_COMMANDS = 100
"""Command ids remembered, so that a repeated command has no further effect."""
HELD_BACK = "scans held back"
"""Counter of scans that made no step because of back-pressure."""

OnStep: TypeAlias = Callable[[steps.Scan], None]

_log = logging.getLogger(__name__)


def main() -> None:
    describe = "Sensor bridge of Cluster-MCL: synchronises, gates and numbers scans."
    process_main("sensor_bridge", run_bridge, describe=describe)


def run_bridge(invocation: Invocation) -> None:
    """Run the bridge until the process is stopped."""
    settings = invocation.settings.bridge
    map_file = map_file_of(settings.map, settings.source)
    if sources.is_published(map_file, settings.source):
        _log.info("waiting for a map on %s/%s", invocation.settings.robot.name, keys.MAP_READING)
        serve_robot(invocation, None, None)
        return
    if not map_file:
        raise errors.SettingsError(key="bridge.map", problem=sources.NO_MAP)
    grid_map = load_map(map_file)
    grid_map = grid_map.with_landmarks(landmarks_of_map(map_file, grid_map.floors))
    serve_robot(invocation, grid_map, source_of(settings))


def source_of(settings: BridgeSettings) -> Source | None:
    """Return the source of readings; None: a robot publishes them."""
    match sources.parsed_source(settings.source):
        case sources.Live():
            return None
        case sources.Recorded(path):
            return recorded_source(path, settings)
        case sources.Simulated():
            start = "start 'python -I -m clustermcl.simulator' instead"
            problem = f"{settings.source} is a simulation: {start}"
            raise errors.SettingsError(key="bridge.source", problem=problem)


def serve_robot(
    invocation: Invocation,
    grid_map: GridMap | None,
    source: Source | None,
    extend: Callable[[Node], OnStep] = lambda _node: lambda _scan: None,
) -> None:
    """Publish the steps of a source and serve the map until the process is stopped.

    Args:
        grid_map: the map to localize in; None: a robot publishes it.
        source: readings; None: a robot publishes them over Zenoh.
        extend: adds to the node what a source needs; returns what to call with each step.

    Raises:
        AlreadyRunningError: the robot has a bridge.
    """
    settings, of, peers = invocation.settings, invocation, keys.COORDINATOR_ALIVE
    new = Node(of.process, "bridge", settings, of.stop, peers=peers, session=of.session)
    with closing(new) as node:
        session = node.open()
        if is_alive(session, keys.BRIDGE_ALIVE, settings.zenoh.query_timeout_s):
            raise errors.AlreadyRunningError(
                what="a sensor bridge",
                robot=settings.robot.name,
                endpoint=settings.zenoh.router,
                advice="stop it, or choose another robot.name",
            )
        kept = settings.coordinator.state_folder
        folder = state_folder(kept) if source is None or kept else None
        Bridge(node, settings.bridge, grid_map, source, extend(node), folder).run()


class Bridge:
    """Makes steps from readings, publishes them, and serves the map and past steps.

    The arguments are those of `serve_robot`; `on_step` is called with each published step. In
    `folder`, the changes of the building are kept; None: they are not.
    """

    def __init__(
        self,
        node: Node,
        settings: BridgeSettings,
        grid_map: GridMap | None,
        source: Source | None,
        on_step: OnStep,
        folder: Path | None = None,
    ) -> None:
        self._node, self._settings, self._source, self._on_step = node, settings, source, on_step
        self._is_live = source is None
        self._landmarks = load_landmarks(settings.landmarks) if settings.landmarks else ()
        """Of maps that the robot publishes."""
        self._changes = BuildingChanges(node, folder)
        self._map = self._use_map(grid_map) if grid_map else None
        self._ask_map_at_s = 0.0
        self._flow = FlowControl(settings.rate if source else 1.0)
        self._history: deque[steps.Scan] = deque(maxlen=steps.KEPT_STEPS)
        self._maker: StepMaker | None = None
        self._refused = Counter[AnyCause]()
        self._has_coordinator = False
        self._next: steps.Reading | steps.Observation | None = None
        self._steps_left = source.steps if source else None
        self._updates: deque[str] = deque(maxlen=KEPT_COMMANDS)
        self._live_settings: LiveSettings | None = None
        """As commanded; None: no command came, so those in the coordinator's status hold."""
        self._scans, self._odometry = node.publisher(keys.SCAN), node.publisher(keys.ODOMETRY)
        node.publish_health(keys.BRIDGE_HEALTH)
        node.serve(keys.MAP, self._on_map_query)
        node.serve(keys.SCAN_HISTORY, self._on_history_query)
        node.serve(keys.UPDATE, self._on_update)
        node.serve(keys.CONFIGURE, self._on_configure)
        node.watch(keys.COORDINATOR_ALIVE, self._on_coordinator)
        node.subscribe(keys.BELIEF, Belief, self._on_belief, kind="belief", kept=1)
        take = self._on_reading
        node.subscribe(
            keys.OBSERVATION_READING, steps.Observation, take, kind="observation", kept=64
        )
        if source is None:
            node.subscribe(
                keys.ODOMETRY_READING, steps.OdometryReading, take, kind="odometry", kept=256
            )
            node.subscribe(keys.LASER_READING, steps.LaserReading, take, kind="laser", kept=16)
            node.subscribe(
                keys.MAP_READING, steps.MapReading, self._on_map_reading, kind="map", kept=1
            )
        node.announce(keys.BRIDGE_ALIVE)

    def run(self) -> None:
        """Serve until the process is stopped; the end of a recording does not end it."""
        waits_until_s = time.monotonic() + WAIT_S if self._is_live else math.inf
        while not self._node.stop.is_set():
            self._node.turn(self._send_due())
            self._changes.renew()
            if self._map is None:
                self._ask_for_map()
            if time.monotonic() > waits_until_s and self._map is not None:
                waits_until_s = math.inf
                self._report_waiting()
        self._changes.save()

    def _report_waiting(self) -> None:
        done = self._node.health.health().done
        for what, key in (("scans", keys.LASER_READING), ("odometry", keys.ODOMETRY_READING)):
            if what not in done and "steps" not in done:  # a scan may have its odometry with it
                _log.info("waiting for %s on %s/%s", what, self._node.robot, key)

    # --- readings

    def _send_due(self) -> float:
        """Send what is due; return the wait until the next reading [s]."""
        now_ns = time.monotonic_ns()
        if self._history and self._flow.is_resend_due(now_ns):
            self._scans.put(self._history[-1])
        if self._source is None or self._flow.waits or not self._has_coordinator:
            return POLL_S
        if self._next is None:
            self._next = next(self._source.readings, None)
        if self._next is None:
            self._finish()
            return POLL_S
        wait_s = self._flow.due_in_s(self._next.stamp_ns, now_ns)
        if wait_s > 0.0:
            return min(wait_s, POLL_S)
        reading, self._next = self._next, None
        self._on_reading(reading)
        return 0.0

    def _on_reading(
        self, reading: steps.Reading | steps.Observation, _received: Received | None = None
    ) -> None:
        health, now_ns = self._node.health, time.monotonic_ns()
        if self._map is None:
            self._node.warn(_log, Cause.BEFORE_MAP, f"stamp {reading.stamp_ns} ns")
            return
        maker = self._maker = self._maker or self._new_maker(self._map)
        if isinstance(reading, steps.Observation):
            maker.observe(reading)
            health.happened("observations")
            self._count_refused(maker.dropped, reading.stamp_ns)
            return
        is_laser = isinstance(reading, steps.LaserReading)
        self._flow.set_gate(maker, now_ns, is_live_scan=self._is_live and is_laser)
        held_back = maker.gate.held_back
        scan = maker.on_reading(reading)
        if maker.gate.held_back > held_back:
            health.happened(HELD_BACK, maker.gate.held_back - held_back)
        health.happened("scans" if is_laser else "odometry")
        self._count_refused(maker.dropped, reading.stamp_ns)
        if not is_laser and not self._flow.lockstep and maker.odometry is not None:
            (stamp_ns, pose), name = maker.odometry, self._node.name
            moved = steps.OdometryReading(sender=name, stamp_ns=stamp_ns, odom_from_robot=pose)
            self._odometry.put(moved)
        if scan is not None:
            self._send(scan)

    def _count_refused(self, dropped: Refused, stamp_ns: int) -> None:
        if dropped != self._refused:
            for cause in (dropped - self._refused).elements():
                detail = dropped.details.get(cause, f"stamp {stamp_ns} ns")
                self._node.warn(_log, cause, detail)
            self._refused = Counter(dropped)

    def _finish(self) -> None:
        """Send the source's last steps, which may still wait for later odometry."""
        if self._maker and (scan := self._maker.finish()):
            self._send(scan)
            return
        self._source = None
        _log.info("the source has ended; the map is still served")

    def _send(self, scan: steps.Scan) -> None:
        if self._steps_left is not None:
            self._steps_left -= 1
            scan = replace(scan, last=self._steps_left == 0)
        self._history.append(scan)
        self._scans.put(scan)
        self._node.health.happened("steps")
        self._flow.on_sent(scan.step, time.monotonic_ns())
        self._on_step(scan)

    def _new_maker(self, first_map: steps.MapMessage) -> StepMaker:
        """Return a step maker that continues after the newest step that a coordinator knows.

        So no number of a step is repeated. The numbers start at 0 if no coordinator answers, or if
        the known number is half of the highest possible one or more.
        """
        first_step, live = 0, self._live_settings
        try:
            status = self._status()
            live = live or status.settings
            known = max(status.step, status.newest_step)
            first_step = known + 1 if known < MAX_SCAN_STEP // 2 else 0
        except errors.ClusterMclError as error:
            _log.info("steps start at 0: %s", error)
        maker = StepMaker(
            self._settings,
            first_map.digest,
            self._node.name,
            first_step=first_step,
            lockstep=self._flow.lockstep,
            live=self._is_live,
            landmarks=first_map.landmarks,
            floors=first_map.floors,
        )
        maker.configure(live or AS_STARTED)
        return maker

    def _status(self) -> Status:
        """Query the coordinator's status; repeat it for one that has a link but no answer yet.

        In lockstep also for the next one, which would ignore step 0, while the bridge waits for it.
        """
        until_s = time.monotonic() + STATUS_TIMEOUT_S
        while True:
            try:
                return ask(self._node.session, keys.STATUS, Status, timeout_s=STATUS_TIMEOUT_S)
            except errors.UnreachableError as error:
                is_there = isinstance(error, errors.RefusedError) or self._has_coordinator
                if not (is_there or self._flow.lockstep) or time.monotonic() > until_s:
                    raise
                time.sleep(POLL_S)

    # --- the map

    def _ask_for_map(self) -> None:
        """Query for a map that was published before this process started."""
        now_s = time.monotonic()
        if now_s >= self._ask_map_at_s:
            self._ask_map_at_s = now_s + ASK_MAP_EVERY_S
            self._node.ask(
                keys.MAP_READING, steps.MapReading, self._on_map_reading, timeout_s=ASK_MAP_EVERY_S
            )

    def _on_map_reading(self, reading: steps.MapReading, _received: Received | None = None) -> None:
        grid_map = from_reading(reading).with_landmarks(self._landmarks)
        if self._map is not None and self._map.digest == grid_map.digest:
            return
        self._map = self._use_map(grid_map)
        self._node.health.happened("maps")
        rows, cols = grid_map.cells.shape
        _log.info("map %.12s of %d x %d cells", grid_map.digest, rows, cols)
        for remark in grid_map.remarks:
            _log.warning("map: %s", remark)
        if self._maker is not None:
            self._maker.change_map(grid_map.digest, grid_map.landmarks)
            self._history.clear()
            self._flow.on_new_map()

    def _use_map(self, grid_map: GridMap) -> steps.MapMessage:
        """Return the map as a message; collect its changes from now on."""
        self._changes.begin(grid_map)
        return to_message(grid_map, self._node.name)

    # --- other messages

    def _on_coordinator(self, token: Token) -> None:
        self._has_coordinator = token.alive

    def _on_belief(self, belief: Belief, _received: Received) -> None:
        if self._maker is not None:
            self._node.health.sources = self._maker.on_belief(belief).health()
        searching = belief.state == "searching"
        self._changes.collect(reversed(self._history), belief)
        self._flow.on_belief(belief.step, belief.term, time.monotonic_ns(), searching=searching)

    def _on_map_query(self, asked: Asked) -> None:
        if self._map is None:
            asked.refuse("no map has arrived yet")
        else:
            asked.answer(self._map)

    def _on_history_query(self, asked: Asked) -> None:
        parameters = asked.query.parameters
        try:
            first = int(str(parameters.get("first", "")))
            last = int(str(parameters.get("last", str(2**62))))
        except ValueError:
            asked.refuse("ask for scans?first=STEP or scans?first=STEP;last=STEP")
            self._node.warn(_log, Cause.BAD_QUESTION, errors.printable(str(parameters)))
            return
        scans = tuple(scan for scan in self._history if first <= scan.step <= last)
        asked.answer(steps.ScanHistory(sender=self._node.name, scans=scans))

    def _on_configure(self, asked: Asked) -> None:
        self._live_settings = decode(asked.payload, Configure).settings
        if self._maker is not None:
            self._maker.configure(self._live_settings)
        asked.answer(CommandDone(sender=self._node.name))

    def _on_update(self, asked: Asked) -> None:
        """Make a step of the next scan; a repeated command has no further effect."""
        command_id = decode(asked.payload, Update).command_id
        if command_id not in self._updates:
            self._updates.append(command_id)
            if self._maker is not None:
                self._maker.gate.open_next()
        asked.answer(CommandDone(sender=self._node.name))
