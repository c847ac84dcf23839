"""The rim of one worker: Zenoh in, Zenoh out; what happens between is `worker.job_table`."""

import logging
import time
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import msgspec
import zenoh

from grid_maps.grid_map import GridMap
from grid_maps.map_message import from_message
from particle_filter.sensor_model import SensorModel
from particle_filter.settings import FilterSettings
from process_runtime.latency_trace import mark
from process_runtime.logs import CauseCounter
from process_runtime.stop import StopFlag
from protocol import keys
from protocol.codec import decode, encode
from protocol.errors import (
    ClusterMclError,
    MalformedMessageError,
    MapMismatchError,
    OldTermError,
    UnreachableError,
    printable,
)
from protocol.steps import MapMessage, Scan, ScanHistory
from protocol.work import (
    Checkpoint,
    OrderAnswer,
    Report,
    TakeOver,
    WorkerState,
    WorkOrder,
)
from worker.job_table import JobTable, MissingScans
from worker.map_model import sensor_model
from worker.term_fence import TermFence
from zenoh_link.health import HealthReporter
from zenoh_link.inbox import Inbox
from zenoh_link.wire import (
    Asked,
    Events,
    Publisher,
    Received,
    Unread,
    ask,
    serve,
    subscribe,
)

MAP_TIMEOUT_S = 30.0
HISTORY_TIMEOUT_S = 5.0
LOST_SCANS_TIMEOUT_S = 0.5
"""The bridge has just sent a scan, so it answers soon what it sent before, or never."""
ASK_AGAIN_S = 0.02
KEPT_SCANS = 64
POLL_S = 0.1
QUIET_S = 0.01
"""After a scan, what nobody waits for is left until so much later: the other workers of this
machine, and the coordinator, need the cores for the step."""
KEPT_CHECKPOINTS = 4
"""Between two looks: some of each of two coordinators of which one takes over."""

_log = logging.getLogger(__name__)


class WorkerLoop:
    """One worker's life between its first connection and its stop."""

    def __init__(
        self, name: str, session: zenoh.Session, cache_folder: Path, incarnation: int
    ) -> None:
        self._name, self._session, self._cache_folder = name, session, cache_folder
        self._incarnation = incarnation
        self._table = JobTable(name)
        self._inbox: Events = Inbox({"scan": KEPT_SCANS})
        self._causes = CauseCounter()
        self._scans_dropped = 0
        self._reports = Publisher(session, keys.worker_report(name), may_wait=True)
        self._health = HealthReporter(name, "worker", self._causes, self._inbox)
        self._health_key = Publisher(session, keys.worker_health(name))
        self._fence = TermFence()
        self._map: GridMap | None = None
        self._model: SensorModel | None = None

    def run(self, stop: StopFlag) -> None:
        """Serve until told to stop."""
        subscribe(self._session, keys.SCAN, self._inbox, "scan")
        checkpoints = Unread(
            self._session, keys.CHECKPOINT, self._inbox, "checkpoint", KEPT_CHECKPOINTS
        )
        serve(self._session, keys.worker_order(self._name), self._inbox)
        serve(self._session, keys.worker_state(self._name), self._inbox)
        with self._session.liveliness().declare_token(keys.worker_alive(self._name)):
            unread_scans = 0
            while not stop.is_set():
                event = self._inbox.get(QUIET_S if unread_scans else POLL_S)
                if isinstance(event, Received):
                    self._on_scan(event, time.monotonic_ns())
                    unread_scans += 1
                    if unread_scans < KEPT_CHECKPOINTS:
                        continue
                unread_scans = 0
                for payload in checkpoints.drain():
                    self._on_checkpoint(payload)
                if isinstance(event, Asked):
                    self._on_query(event)
                self._health.publish_if_due(self._health_key)

    def _on_scan(self, received: Received, taken_ns: int) -> None:
        try:
            scan = decode(received.payload, Scan)
            mark("arrived", scan, received.at_ns)
            mark("taken", scan, taken_ns)
            mark("decoded", scan)
            self._health.happened("scans")
        except MalformedMessageError as error:
            self._causes.warn(_log, error.cause, error, time.monotonic())
            return
        if self._map is not None and scan.map_digest != self._map.digest:
            detail = f"step {scan.step} is of map {printable(scan.map_digest, 12)}"
            self._causes.warn(_log, "scan of another map", detail, time.monotonic())
            return
        lost = self._table.lost_before(scan)
        if lost and not self._has_fallen_behind():
            for past in self._fetch(lost, LOST_SCANS_TIMEOUT_S):
                self._publish(self._table.on_scan(past))
        reports = self._table.on_scan(scan)
        mark("computed", scan)
        self._publish(reports)

    def _has_fallen_behind(self) -> bool:
        """Whether scans were dropped here since the last look: who is too slow must skip some."""
        dropped = self._inbox.dropped().get("scan", 0)
        known, self._scans_dropped = self._scans_dropped, dropped
        return dropped > known

    def _on_checkpoint(self, payload: bytes) -> None:
        try:
            self._fence.keep(decode(payload, Checkpoint), payload)
        except MalformedMessageError as error:
            self._causes.warn(_log, error.cause, error, time.monotonic())

    def _on_query(self, asked: Asked) -> None:
        if asked.key.endswith("/state"):
            self._tell_state(asked)
            return
        try:
            order = decode(asked.payload, WorkOrder)
            again = [] if self._table.is_news(order) else self._table.said_last()
            self._follow(order)
        except (ClusterMclError, msgspec.ValidationError, ValueError) as error:
            self._causes.warn(_log, _cause_of_refusal(error), error, time.monotonic())
            asked.answer(self._answer(problem=str(error)))
            return
        asked.answer(self._answer())
        self._publish(again)
        self._catch_up()

    def _tell_state(self, asked: Asked) -> None:
        """Say what this worker does; to a new coordinator, all that it needs to carry on."""
        if not asked.payload:
            asked.answer(self._answer())
            return
        try:
            self._fence.hear(decode(asked.payload, TakeOver).term)
        except MalformedMessageError as error:
            self._causes.warn(_log, error.cause, error, time.monotonic())
            asked.refuse(str(error))
            return
        state = WorkerState(
            sender=self._name,
            term=self._fence.term,
            incarnation=self._incarnation,
            holds=self._table.holds(),
            checkpoint=self._fence.checkpoint,
            reports=tuple(map(encode, self._table.reports_since(self._fence.step))),
        )
        asked.answer(state)

    def _follow(self, order: WorkOrder) -> None:
        if not self._fence.check(order):
            detail = f"order {order.order} after {self._fence.order}"
            self._causes.warn(_log, "order overtaken", detail, time.monotonic())
            return
        settings = msgspec.convert(order.filter_settings, FilterSettings)
        if order.begin:
            self._prepare(order.map_digest, settings)
        if self._model is not None:
            self._table.follow(order, self._model, settings)
        self._fence.order = order.order

    def _prepare(self, map_digest: str, settings: FilterSettings) -> None:
        """Have the map of that digest, as the settings' sensor sees it."""
        if self._map is None or self._map.digest != map_digest:
            message = ask(self._session, keys.MAP, MapMessage, timeout_s=MAP_TIMEOUT_S)
            if message.digest != map_digest:
                raise MapMismatchError(worker=self._name, expected=map_digest, found=message.digest)
            self._map, self._model = from_message(message), None
        if self._model is None or self._model.settings != settings.sensor:
            self._model = sensor_model(self._map, settings.sensor, self._cache_folder)
            self._map = replace(self._map, cells=self._model.grid.cells)  # shared by all workers

    def _catch_up(self) -> None:
        missing = self._table.missing()
        history = self._fetch(missing, HISTORY_TIMEOUT_S) if missing else ()
        self._publish(self._table.catch_up(history))

    def _fetch(self, missing: MissingScans, timeout_s: float) -> tuple[Scan, ...]:
        """Ask the bridge; just after a link came up, a query may find nobody, and is repeated."""
        selector = keys.scan_history(missing.first, missing.last)
        until_s = time.monotonic() + LOST_SCANS_TIMEOUT_S
        while True:
            try:
                return ask(self._session, selector, ScanHistory, timeout_s=timeout_s).scans
            except ClusterMclError as error:
                if not isinstance(error, UnreachableError) or time.monotonic() >= until_s:
                    self._causes.warn(_log, "no scan history", error, time.monotonic())
                    return ()
            time.sleep(ASK_AGAIN_S)

    def _publish(self, reports: Iterable[Report]) -> None:
        for report in reports:
            self._reports.put(report)
            self._health.happened("reports")

    def _answer(self, problem: str = "") -> OrderAnswer:
        return OrderAnswer(
            sender=self._name,
            order=self._fence.order,
            term=self._fence.term,
            incarnation=self._incarnation,
            jobs=self._table.summary(),
            problem=problem,
        )


def _cause_of_refusal(error: Exception) -> str:
    """What to count a refused order as: fixed words."""
    match error:
        case MalformedMessageError():
            return error.cause
        case MapMismatchError():
            return "order for another map"
        case OldTermError():
            return "order of an old term"
        case _:
            return "order refused"
