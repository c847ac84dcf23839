"""What one worker decides: told what happened, answers what is to be done."""

from collections import deque
from dataclasses import dataclass
from typing import Any

import msgspec

from particle_filter.settings import FilterSettings, SensorSettings, filter_with
from protocol.codec import encode
from protocol.errors import MalformedMessageError, MapMismatchError, OldTermError, printable
from protocol.live_settings import AS_STARTED
from protocol.steps import MapMessage, Scan
from protocol.work import OrderAnswer, Report, TakeOver, WorkerState, WorkOrder
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
from worker.term_fence import TermFence

HISTORY_TIMEOUT_S = 5.0
LOST_SCANS_TIMEOUT_S = 0.5
"""The bridge has just sent a scan, so it answers soon what it sent before, or never."""


@dataclass(frozen=True)
class _WaitingOrder:
    """An order that is followed as soon as there is a sensor model for it."""

    question: Any
    order: WorkOrder
    settings: FilterSettings


class Worker:
    """One worker: the jobs it has, whom it obeys, and the map as its sensors see it.

    Never waits: what it needs from others (the map, past scans) it asks for with an instruction,
    and hears of with an event. Meanwhile it goes on with what it can do.

    Args:
        name: the worker's own.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._table, self._fence = JobTable(name), TermFence()
        self._map: MapMessage | None = None
        self._built: ModelBuilt | None = None
        self._preparing = False
        """The map has been asked for, or its sensor model is being built."""
        self._waiting: _WaitingOrder | None = None
        self._ordered: FilterSettings | None = None
        """The filter's numbers, as the last order had them."""
        self._live = AS_STARTED
        """What holds in their place, by the newest scan."""
        self._in_force: FilterSettings | None = None
        """What the jobs go by."""
        self._held: deque[Scan] = deque(maxlen=RECENT_SCANS)
        """Scans that wait for a sensor model with other numbers."""
        self._fetching: MissingScans | None = None
        self._dropped = 0

    @property
    def searches(self) -> bool:
        """Whether it has something to do as soon as there is time: see `TimeToSearch`."""
        return self._table.searches

    def handle(self, event: Event) -> list[Instruction]:  # noqa: PLR0911 - one for each event
        """Take what has happened; what is to be done comes in its order."""
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
        """Whether the jobs go by the numbers that hold at a scan, or there are none yet."""
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
        """Take the scans that were held."""
        held, self._held = self._held, deque(maxlen=RECENT_SCANS)
        return [do for scan in held for do in self._on_scan(scan, self._dropped)]

    def _is_of_another_map(self, scan: Scan) -> bool:
        return self._map is not None and scan.map_digest != self._map.digest

    def _has_fallen_behind(self, dropped: int) -> bool:
        """Whether scans were dropped here since the last gap: who is too slow must skip some."""
        known, self._dropped = self._dropped, dropped
        return dropped > known

    def _fetch(self, missing: MissingScans | None, timeout_s: float) -> list[Instruction]:
        """Ask for past scans, unless the same are being asked for; a later question counts."""
        if missing is None or missing == self._fetching:
            return []
        self._fetching = missing
        return [FetchScans(missing, timeout_s)]

    def _on_history(self, missing: MissingScans, scans: tuple[Scan, ...]) -> list[Instruction]:
        if missing != self._fetching:
            return []  # more has been asked for since
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
        # Who gave the one before has given this one since, and no longer expects it to be done.
        answered = [Answer(before.question, self._answer())] if before else []
        return [*answered, *self._go_on()]

    def _overtaken(self, question: Any, order: WorkOrder) -> list[Instruction]:
        detail = f"order {order.order} after {self._fence.newest}"
        return [Warn("order overtaken", detail), Answer(question, self._answer())]

    def _go_on(self) -> list[Instruction]:
        """Follow the order that waits and take the scans that do, or get what they need."""
        waiting, settings = self._waiting, self._ordered
        if waiting is not None:
            settings, digest = waiting.settings, waiting.order.map_digest
        elif self._held and self._built is not None:
            digest = self._built.map_digest
        else:
            return []
        assert settings is not None  # a scan is held only by a worker that has followed an order
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
            if not self._fence.check(order):  # once more: it may have waited for long
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
        """All that a new coordinator needs to carry on."""
        self._fence.hear(take_over.term)
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
