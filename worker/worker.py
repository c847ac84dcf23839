"""The decisions of one worker: it takes events and returns instructions."""

from collections import deque
from dataclasses import dataclass
from typing import Any

import msgspec

from particle_filter.settings import FilterSettings, SensorSettings, filter_with
from protocol.codec import encode
from protocol.errors import MalformedMessageError, MapMismatchError, OldTermError, printable
from protocol.live_settings import AS_STARTED
from protocol.steps import MapMessage, Scan
from protocol.work import Checkpoint, OrderAnswer, Report, TakeOver, WorkerState, WorkOrder
from worker.events import (
    BrokenOrderAsked,
    CheckpointHeard,
    Event,
    HistoryArrived,
    HistoryFailed,
    MapArrived,
    MapFailed,
    ModelBuilt,
    OrderAsked,
    ScanArrived,
    StateAsked,
    TimeToSearch,
)
from worker.instructions import (
    Answer,
    BuildModel,
    FetchMap,
    FetchScans,
    Instruction,
    PublishReport,
    Warn,
)
from worker.job_table import RECENT_SCANS, JobTable, MissingScans

HISTORY_TIMEOUT_S = 5.0
LOST_SCANS_TIMEOUT_S = 0.5
"""The bridge has just sent a scan, so it answers soon or never."""
KEPT_TERMS = 16
"""Terms remembered: more than coordinators that ask before one of them begins."""


class TermFence:
    """Which coordinator a worker obeys: that of the highest term."""

    def __init__(self) -> None:
        self.term = 0
        """The highest known."""
        self.founded = 0
        """The highest term of a checkpoint that was founded."""
        self.order = 0
        """The last order followed."""
        self.newest = 0
        """The highest order received, followed or not."""
        self._terms: deque[int] = deque(maxlen=KEPT_TERMS)

    @property
    def terms(self) -> tuple[int, ...]:
        """The last terms, in the order in which they became known."""
        return tuple(self._terms)

    def on_term(self, term: int) -> None:
        """Note a coordinator's term; from now on refuse orders of lower ones."""
        if term and term not in self._terms:
            self._terms.append(term)
        if term > self.term:
            self.term, self.order, self.newest = term, 0, 0

    def on_checkpoint(self, checkpoint: Checkpoint) -> None:
        """Note that a coordinator has begun and lives."""
        self.on_term(checkpoint.term)
        if checkpoint.founded:
            self.founded = max(self.founded, checkpoint.term)

    def check(self, order: WorkOrder) -> bool:
        """Return whether to follow an order; False if a later one has overtaken it.

        Raises:
            OldTermError: its coordinator was deposed.
        """
        if order.term < self.term:
            raise OldTermError(term=order.term, ruling=self.term)
        self.on_term(order.term)
        if order.order < self.newest:
            return False
        self.newest = order.order
        return True


@dataclass(frozen=True)
class _WaitingOrder:
    """An order that waits for its sensor model."""

    question: Any
    order: WorkOrder
    settings: FilterSettings


class Worker:
    """One worker: its jobs, the coordinator that it obeys, and the map's sensor model.

    It never waits. It requests the map and past scans by an instruction, which an event answers;
    meanwhile it does what it can.

    Args:
        name: the worker's name.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._table, self._fence = JobTable(name), TermFence()
        self._map: MapMessage | None = None
        self._built: ModelBuilt | None = None
        self._preparing = False
        """The map was requested, or its sensor model is being built."""
        self._waiting: _WaitingOrder | None = None
        self._ordered: FilterSettings | None = None
        """Settings of the last order."""
        self._live = AS_STARTED
        """Settings that override them since the newest scan."""
        self._in_force: FilterSettings | None = None
        """Settings that the jobs use."""
        self._held: deque[Scan] = deque(maxlen=RECENT_SCANS)
        """Scans that wait for a sensor model with other settings."""
        self._fetching: MissingScans | None = None
        self._dropped = 0

    @property
    def searches(self) -> bool:
        """Whether there is work for `TimeToSearch`."""
        return self._table.searches

    def handle(self, event: Event) -> list[Instruction]:  # noqa: PLR0911 - one for each event
        """Take an event; return instructions in the order of their execution."""
        match event:
            case ScanArrived(scan, dropped):
                return self._on_scan(scan, dropped)
            case CheckpointHeard(checkpoint):
                self._fence.on_checkpoint(checkpoint)
                return []
            case OrderAsked(question, order):
                return self._on_order(question, order)
            case BrokenOrderAsked(question, error):
                return self._refused(question, error)
            case StateAsked(question, take_over):
                return [Answer(question, self._state(take_over) if take_over else self._answer())]
            case MapArrived(message):
                return self._on_map(message)
            case MapFailed(error):
                self._preparing, self._map = False, None
                return self._refuse_waiting(error)
            case ModelBuilt():
                self._preparing, self._built = False, event
                return self._go_on()
            case HistoryArrived(missing, scans):
                return self._on_history(missing, scans)
            case HistoryFailed(missing, problem):
                return [Warn("no scan history", problem), *self._on_history(missing, ())]
            case TimeToSearch():
                return _published(self._table.search_on())

    # --- scans

    def _on_scan(self, scan: Scan, dropped: int) -> list[Instruction]:
        if self._is_of_another_map(scan):
            detail = f"step {scan.step} is of map {printable(scan.map_digest, 12)}"
            return [Warn("scan of another map", detail)]
        if not self._is_prepared(scan):
            self._held.append(scan)
            return self._go_on()
        lost = self._table.lost_before(scan)
        if lost is None or self._has_fallen_behind(dropped):
            return _published(self._table.on_scan(scan))
        self._table.wait_for(lost)
        reports = self._table.on_scan(scan)
        return [*_published(reports), *self._fetch(self._table.missing(), LOST_SCANS_TIMEOUT_S)]

    def _is_prepared(self, scan: Scan) -> bool:
        """Apply a scan's settings; return False if they need another sensor model first."""
        if self._held:
            return False
        self._live = scan.settings
        if self._built is None or self._ordered is None:
            return True
        settings = filter_with(self._ordered, scan.settings)
        if self._built.model.settings != settings.sensor:
            return False
        if self._in_force != settings:
            self._in_force = settings
            self._table.use(self._built.model, settings)
        return True

    def _release(self) -> list[Instruction]:
        """Take the held scans."""
        held, self._held = self._held, deque(maxlen=RECENT_SCANS)
        return [do for scan in held for do in self._on_scan(scan, self._dropped)]

    def _is_of_another_map(self, scan: Scan) -> bool:
        return self._map is not None and scan.map_digest != self._map.digest

    def _has_fallen_behind(self, dropped: int) -> bool:
        """Return whether this process dropped scans since the last gap, because it is too slow."""
        known, self._dropped = self._dropped, dropped
        return dropped > known

    def _fetch(self, missing: MissingScans | None, timeout_s: float) -> list[Instruction]:
        """Request past scans, unless the same are requested already; the last request counts."""
        if missing is None or missing == self._fetching:
            return []
        self._fetching = missing
        return [FetchScans(missing, timeout_s)]

    def _on_history(self, missing: MissingScans, scans: tuple[Scan, ...]) -> list[Instruction]:
        if missing != self._fetching:
            return []  # more was requested since
        self._fetching = None
        self._table.wait_for(None)
        fitting = [scan for scan in scans if not self._is_of_another_map(scan)]
        return _published(self._table.catch_up(fitting))

    # --- orders

    def _on_order(self, question: Any, order: WorkOrder) -> list[Instruction]:
        try:
            settings = msgspec.convert(order.filter_settings, FilterSettings)
            if not self._fence.check(order):
                return self._overtaken(question, order)
        except (OldTermError, msgspec.ValidationError) as error:
            return self._refused(question, error)
        before, self._waiting = self._waiting, _WaitingOrder(question, order, settings)
        # The coordinator no longer expects the order before to be followed.
        answered = [Answer(before.question, self._answer())] if before else []
        return [*answered, *self._go_on()]

    def _overtaken(self, question: Any, order: WorkOrder) -> list[Instruction]:
        detail = f"order {order.order} after {self._fence.newest}"
        return [Warn("order overtaken", detail), Answer(question, self._answer())]

    def _go_on(self) -> list[Instruction]:
        """Follow the waiting order and take the held scans, or request what they need."""
        waiting, settings = self._waiting, self._ordered
        if waiting is not None:
            settings, digest = waiting.settings, waiting.order.map_digest
        elif self._held and self._built is not None:
            digest = self._built.map_digest
        else:
            return []
        assert settings is not None  # scans are held only after an order was followed
        sensor = filter_with(settings, self._live).sensor
        has_model = self._has_model(digest, sensor)
        if waiting is not None and (has_model or not waiting.order.begin):
            return [*self._follow(waiting), *self._go_on()]
        if has_model:
            return self._release()
        if self._preparing:
            return []
        self._preparing = True
        if self._map is None or self._map.digest != digest:
            return [FetchMap()]
        return [BuildModel(self._map, sensor)]

    def _has_model(self, map_digest: str, sensor: SensorSettings) -> bool:
        built = self._built
        if built is None or built.map_digest != map_digest:
            return False
        return built.model.settings == sensor

    def _on_map(self, message: MapMessage) -> list[Instruction]:
        self._preparing = False
        if self._waiting is None and self._built is not None and self._held:
            expected = self._built.map_digest
        elif self._waiting is not None:
            expected = self._waiting.order.map_digest
        else:
            return []
        if message.digest != expected:
            error = MapMismatchError(worker=self._name, expected=expected, found=message.digest)
            return self._refuse_waiting(error)
        self._map = message
        return self._go_on()

    def _follow(self, waiting: _WaitingOrder) -> list[Instruction]:
        self._waiting = None
        order = waiting.order
        again = [] if self._table.is_news(order) else self._table.said_last()
        try:
            if not self._fence.check(order):  # again: it may have waited
                return self._overtaken(waiting.question, order)
            if self._built is not None:
                settings = filter_with(waiting.settings, self._live)
                self._table.follow(order, self._built.model, settings)
                self._ordered = waiting.settings
        except (OldTermError, ValueError) as error:
            return self._refused(waiting.question, error)
        self._fence.order = order.order
        missing = self._table.missing()
        self._table.wait_for(missing)
        return [
            Answer(waiting.question, self._answer()),
            *_published([*again, *self._table.catch_up()]),
            *self._fetch(missing, HISTORY_TIMEOUT_S),
        ]

    def _refuse_waiting(self, error: Exception) -> list[Instruction]:
        waiting, self._waiting = self._waiting, None
        return self._refused(waiting.question, error) if waiting else []

    def _refused(self, question: Any, error: Exception) -> list[Instruction]:
        problem = str(error)
        return [Warn(_cause_of(error), problem), Answer(question, self._answer(problem))]

    # --- answers

    def _answer(self, problem: str = "") -> OrderAnswer:
        return OrderAnswer(
            sender=self._name,
            order=self._fence.order,
            term=self._fence.term,
            jobs=self._table.summary(),
            problem=problem,
        )

    def _state(self, take_over: TakeOver) -> WorkerState:
        """Return what a new coordinator needs to continue."""
        self._fence.on_term(take_over.term)
        return WorkerState(
            sender=self._name,
            term=self._fence.term,
            holds=self._table.holds(),
            terms=self._fence.terms,
            founded=self._fence.founded,
            reports=tuple(map(encode, self._table.reports_since(take_over.since))),
        )


def _published(reports: list[Report]) -> list[Instruction]:
    return [PublishReport(report) for report in reports]


def _cause_of(error: Exception) -> str:
    """Return the counter's name of a refused order, a constant."""
    match error:
        case MalformedMessageError():
            return error.cause
        case MapMismatchError():
            return "order for another map"
        case OldTermError():
            return "order of an old term"
        case _:
            return "order refused"
