"""The rim of the bridge: readings in, steps out; the map and past steps to whoever asks."""

import logging
import time
from collections import Counter, deque
from collections.abc import Callable

import msgspec
import zenoh

from grid_maps.grid_map import GridMap
from grid_maps.map_message import from_reading, to_message
from process_runtime.logs import CauseCounter
from process_runtime.settings import BridgeSettings
from process_runtime.stop import StopFlag
from protocol import keys
from protocol.answers import Belief, CommandDone, Configure, Status, Update
from protocol.codec import decode
from protocol.errors import ClusterMclError, MalformedMessageError, RefusedError, printable
from protocol.live_settings import AS_STARTED, LiveSettings
from protocol.message import MAX_SCAN_STEP
from protocol.steps import (
    LaserReading,
    MapMessage,
    MapReading,
    OdometryReading,
    Reading,
    Scan,
    ScanHistory,
)
from sensor_bridge.flow_control import FlowControl
from sensor_bridge.pacing import Pacing
from sensor_bridge.source import Extension, Source
from sensor_bridge.standing_robot import StandingRobot
from sensor_bridge.step_history import StepHistory
from sensor_bridge.step_maker import StepMaker
from zenoh_link.health import HealthReporter
from zenoh_link.inbox import Inbox
from zenoh_link.stale_session import STALE, StaleSessionDetector
from zenoh_link.wire import (
    Asked,
    Event,
    Events,
    Publisher,
    Received,
    Token,
    ask,
    ask_later,
    serve,
    subscribe,
    watch,
    watch_link,
)

POLL_S = 0.1
ASK_MAP_EVERY_S = 1.0
ASK_STEP_WITHIN_S = 5.0
"""A coordinator that is there may have too much to do; where none is, nothing is waited for."""
KEPT_COMMANDS = 100
"""A command that is asked once more does nothing, if it is one of the last."""
HELD_BACK = "scans held back"
"""As what is counted: the robot had moved, but steps are made faster than they are decided."""

_log = logging.getLogger(__name__)


class BridgeLoop:
    """One bridge's life between its connection and its stop."""

    def __init__(
        self,
        name: str,
        session: zenoh.Session,
        settings: BridgeSettings,
        grid_map: GridMap | None,
        source: Source | None,
        extension: Extension,
        is_coordinator_there: Callable[[], bool],
    ) -> None:
        self._is_coordinator_there, self._stale = is_coordinator_there, StaleSessionDetector()
        self._session, self._settings, self._source = session, settings, source
        self._live = source is None
        self._extension = extension
        self._name = name
        self._map: MapMessage | None = to_message(grid_map, name) if grid_map else None
        self._ask_map_at_s = 0.0
        self._pacing = Pacing(settings.rate if source else 1.0)
        self._standing = StandingRobot()
        self._history = StepHistory(settings.history_steps)
        self._causes = CauseCounter()
        self._inbox: Events = Inbox({"odometry": 256, "laser": 16, "belief": 1, "map": 1})
        self._health = HealthReporter(name, "bridge", self._causes, self._inbox)
        self._health_key = Publisher(session, keys.BRIDGE_HEALTH)
        self._scans = Publisher(session, keys.SCAN)
        self._odometry = Publisher(session, keys.ODOMETRY)
        self._maker: StepMaker | None = None
        self._flow = FlowControl()
        self._refused: Counter[str] = Counter()
        self._coordinator_there = False
        self._next: Reading | None = None
        self._steps_left = source.steps if source else None
        self._updates: deque[str] = deque(maxlen=KEPT_COMMANDS)
        self._live_settings: LiveSettings | None = None
        """As commanded; None: not yet, and what a coordinator knows counts."""

    def run(self, stop: StopFlag) -> None:
        """Serve until told to stop or until deaf; a recording's end does not end it."""
        watch_link(self._session, self._inbox)
        serve(self._session, keys.MAP, self._inbox)
        serve(self._session, keys.SCAN_HISTORY, self._inbox)
        serve(self._session, keys.UPDATE, self._inbox)
        serve(self._session, keys.CONFIGURE, self._inbox)
        for key in self._extension.serves:
            serve(self._session, key, self._inbox)
        watch(self._session, keys.COORDINATOR_ALIVE, self._inbox)
        subscribe(self._session, keys.BELIEF, self._inbox, "belief")
        if self._source is None:
            subscribe(self._session, keys.ODOMETRY_READING, self._inbox, "odometry")
            subscribe(self._session, keys.LASER_READING, self._inbox, "laser")
            subscribe(self._session, keys.MAP_READING, self._inbox, "map")
        with self._session.liveliness().declare_token(keys.BRIDGE_ALIVE):
            while not (stop.is_set() or self._is_session_stale()):
                self._handle(self._inbox.get(self._send_due()))
                if self._map is None:
                    self._ask_for_map()
                self._health.publish_if_due(self._health_key)

    def _is_session_stale(self) -> bool:
        is_stale = self._stale.is_suspect(time.monotonic_ns()) and self._is_coordinator_there()
        if is_stale:
            _log.warning(STALE)
        return is_stale

    # --- readings

    def _send_due(self) -> float:
        """Send what is due; returns how long to wait for the next [s]."""
        now_ns = time.monotonic_ns()
        newest = self._history.newest()
        if newest is not None and self._pacing.resend_due(now_ns):
            self._scans.put(newest)
        if self._source is None or self._pacing.waits or not self._coordinator_there:
            return POLL_S
        if self._next is None:
            self._next = self._source.next_reading()
        if self._next is None:
            self._finish()
            return POLL_S
        wait_s = self._pacing.due_in_s(self._next.stamp_ns, now_ns)
        if wait_s > 0.0:
            return min(wait_s, POLL_S)
        reading, self._next = self._next, None
        self._take(reading)
        return 0.0

    def _take(self, reading: Reading) -> None:
        if self._map is None:
            detail = f"stamp {reading.stamp_ns} ns"
            self._causes.warn(_log, "reading before the map", detail, time.monotonic())
            return
        if self._maker is None:
            self._maker = self._new_maker(self._map)
        if self._live and isinstance(reading, LaserReading):
            self._look_again_if_it_stands(self._maker)
        if not self._pacing.paced:
            self._maker.hold(self._flow.is_full(time.monotonic_ns()))
        held_back = self._maker.held_back
        scan = self._maker.on_reading(reading)
        for _ in range(self._maker.held_back - held_back):
            self._health.happened(HELD_BACK)
        self._health.happened("odometry" if isinstance(reading, OdometryReading) else "scans")
        if self._maker.dropped != self._refused:
            self._count_refused(self._maker.dropped, reading.stamp_ns)
        if isinstance(reading, OdometryReading) and not self._pacing.paced:
            self._put_odometry(self._maker)
        if scan is not None:
            self._send(scan)

    def _look_again_if_it_stands(self, maker: StepMaker) -> None:
        if maker.stands and self._standing.wants_step(time.monotonic_ns()):
            maker.force_next()

    def _count_refused(self, dropped: Counter[str], stamp_ns: int) -> None:
        """Count, and say once a minute, what the step maker could not use."""
        for cause, times in (dropped - self._refused).items():
            for _ in range(times):
                what = f"reading refused: {cause.replace('_', ' ')}"
                self._causes.warn(_log, what, f"stamp {stamp_ns} ns", time.monotonic())
        self._refused = dropped.copy()

    def _put_odometry(self, maker: StepMaker) -> None:
        """Pass the newest odometry on, in the frame of the steps."""
        if maker.odometry is not None:
            stamp_ns, pose = maker.odometry
            self._odometry.put(
                OdometryReading(sender=self._name, stamp_ns=stamp_ns, odom_from_robot=pose)
            )

    def _finish(self) -> None:
        """The source has ended: its last steps may still be waiting for later odometry."""
        scan = self._maker.finish() if self._maker else None
        if scan is not None:
            self._send(scan)
            return
        self._source = None
        _log.info("the source has ended; the map is still served")

    def _send(self, scan: Scan) -> None:
        if self._steps_left is not None:
            self._steps_left -= 1
            scan = msgspec.structs.replace(scan, last=self._steps_left == 0)
        self._history.add(scan)
        self._scans.put(scan)
        self._health.happened("steps")
        self._pacing.step_sent(scan.step, time.monotonic_ns())
        self._standing.step_sent(scan.step, time.monotonic_ns())
        self._flow.step_sent(scan.step)
        self._extension.on_step(scan)

    def _new_maker(self, first_map: MapMessage) -> StepMaker:
        """Steps go on after those that a coordinator knows: a restarted bridge repeats none.

        Where those are near the highest that there can be, they begin anew.
        """
        first_step, live = 0, self._live_settings
        try:
            status = self._status()
            live = live or status.settings
            known = max(status.step, status.newest_step)
            first_step = known + 1 if known < MAX_SCAN_STEP // 2 else 0
        except ClusterMclError as error:
            _log.info("steps start at 0: %s", error)
        maker = StepMaker(
            self._settings,
            first_map.digest,
            self._name,
            first_step=first_step,
            paced=self._pacing.paced,
            live=self._live,
        )
        maker.configure(live or AS_STARTED)
        return maker

    def _status(self) -> Status:
        """What a coordinator tells; one that refuses now, for its link has just come back, soon."""
        until_s = time.monotonic() + ASK_STEP_WITHIN_S
        while True:
            try:
                return ask(self._session, keys.STATUS, Status, timeout_s=ASK_STEP_WITHIN_S)
            except RefusedError:
                if time.monotonic() > until_s:
                    raise
                time.sleep(POLL_S)

    # --- the map

    def _ask_for_map(self) -> None:
        """Ask whoever has published a map before this process was there."""
        now_s = time.monotonic()
        if now_s >= self._ask_map_at_s:
            self._ask_map_at_s = now_s + ASK_MAP_EVERY_S
            ask_later(
                self._session,
                keys.MAP_READING,
                lambda answer: self._inbox.put_newest("map", answer),
                lambda _refused: None,
                timeout_s=ASK_MAP_EVERY_S,
            )

    def _follow_map(self, grid_map: GridMap) -> None:
        """The robot has a map, or another one: steps are of it from now on."""
        if self._map is not None and self._map.digest == grid_map.digest:
            return
        self._map = to_message(grid_map, self._name)
        self._health.happened("maps")
        rows, cols = grid_map.cells.shape
        _log.info("map %.12s of %d x %d cells", grid_map.digest, rows, cols)
        if self._maker is not None:
            self._maker.change_map(grid_map.digest)
            self._history = StepHistory(self._settings.history_steps)
            self._standing.new_map()

    # --- what arrives

    def _handle(self, event: Event | None) -> None:
        self._stale.on_event(event, time.monotonic_ns())
        try:
            match event:
                case Asked():
                    self._answer(event)
                case Token():
                    self._coordinator_there = event.alive
                case Received(key=keys.BELIEF):
                    belief = decode(event.payload, Belief)
                    self._pacing.believed(belief.step, belief.term)
                    searching = belief.state == "searching"
                    self._standing.believed(belief.step, belief.term, searching=searching)
                    self._flow.believed(belief.step, time.monotonic_ns())
                case Received(key=keys.ODOMETRY_READING):
                    self._take(decode(event.payload, OdometryReading))
                case Received(key=keys.LASER_READING):
                    self._take(decode(event.payload, LaserReading))
                case Received(key=keys.MAP_READING):
                    self._follow_map(from_reading(decode(event.payload, MapReading)))
        except MalformedMessageError as error:
            self._causes.warn(_log, error.cause, error, time.monotonic())

    def _answer(self, asked: Asked) -> None:
        if asked.key == keys.MAP:
            if self._map is None:
                asked.refuse("no map has come yet")
            else:
                asked.answer(self._map)
            return
        if asked.key == keys.UPDATE:
            self._on_update(asked)
            return
        if asked.key == keys.CONFIGURE:
            self._on_configure(asked)
            return
        if asked.key in self._extension.serves:
            self._extension.serves[asked.key](asked)
            return
        parameters = asked.query.parameters
        try:
            first = int(str(parameters.get("first", "")))
            last = int(str(parameters.get("last", str(2**62))))
        except ValueError:
            problem = "ask for scans?first=STEP or scans?first=STEP;last=STEP"
            asked.refuse(problem)
            said = printable(str(parameters))
            self._causes.warn(_log, "malformed question for scans", said, time.monotonic())
            return
        scans = tuple(self._history.between(first, last))
        asked.answer(ScanHistory(sender=self._name, scans=scans))

    def _on_configure(self, asked: Asked) -> None:
        try:
            self._live_settings = decode(asked.payload, Configure).settings
        except MalformedMessageError as error:
            asked.refuse(str(error))
            raise
        if self._maker is not None:
            self._maker.configure(self._live_settings)
        asked.answer(CommandDone(sender=self._name))

    def _on_update(self, asked: Asked) -> None:
        """Make a step of the next scan; the very first becomes one anyway."""
        try:
            command = decode(asked.payload, Update)
        except MalformedMessageError as error:
            asked.refuse(str(error))
            raise
        if command.command_id not in self._updates:
            self._updates.append(command.command_id)
            if self._maker is not None:
                self._maker.force_next()
        asked.answer(CommandDone(sender=self._name))
