"""The decisions of one worker, whose methods take events and return instructions."""

from collections import deque
from collections.abc import Iterable
from typing import Any, TypeAlias

import msgspec

from clustermcl.filter.advice.view_memory import ViewMemory
from clustermcl.filter.laser.sensor_model import SensorModel
from clustermcl.filter.settings import FilterSettings, SensorSettings, filter_with
from clustermcl.protocol import work
from clustermcl.protocol.advice import Advice, AdviceQuestion
from clustermcl.protocol.causes import AnyCause, Cause
from clustermcl.protocol.conversion import converted
from clustermcl.protocol.errors import (
    MalformedMessageError,
    MapMismatchError,
    OldTermError,
    printable,
)
from clustermcl.protocol.live_settings import AS_STARTED
from clustermcl.protocol.steps import MapMessage, Scan
from clustermcl.protocol.work import Report
from clustermcl.worker.job_table import RECENT_SCANS_OF_WAITING, JobTable, MissingScans

HISTORY_TIMEOUT_S = 5.0
LOST_SCANS_TIMEOUT_S = 0.5
"""Timeout of a query after a gap: the bridge has just sent a scan, so it answers soon or never."""
KEPT_TERMS = 16
"""Number of remembered terms, more than coordinators that compete for a take-over."""


class Answer(msgspec.Struct, frozen=True):
    """Answer a query, once."""

    question: Any
    message: work.OrderAnswer | work.WorkerState | Advice


class FetchMap(msgspec.Struct, frozen=True):
    """Query the bridge for the map, for `on_map` or `on_map_failure`."""


class BuildModel(msgspec.Struct, frozen=True):
    """Compute or read a map's sensor model in up to a minute, for `on_model`; see `FetchMap`."""

    map: MapMessage
    settings: SensorSettings


class FetchScans(msgspec.Struct, frozen=True):
    """Query the bridge for past steps, for `on_history` or `on_no_history`."""

    missing: MissingScans
    timeout_s: float


class Warn(msgspec.Struct, frozen=True):
    """Count a fault, and log each cause at most once a period."""

    cause: AnyCause
    detail: str


class Advise(msgspec.Struct, frozen=True):
    """Compute the answer to a query for advice; see `Adviser`."""

    question: Any
    asked: AdviceQuestion
    scan: Scan
    model: SensorModel
    settings: FilterSettings


Instruction: TypeAlias = Report | Answer | FetchMap | BuildModel | FetchScans | Warn | Advise
"""A report is published."""


class TermFence:
    """The rule that a worker follows the coordinator with the highest term."""

    def __init__(self) -> None:
        self.term = 0
        self.terms: tuple[int, ...] = ()
        """The last terms, in the order in which they became known."""
        self.founded = 0
        """The highest term of a received checkpoint with clusters; 0: none."""
        self.order = 0
        """Number of the last order followed."""
        self.newest = 0
        """Highest number of an order received, followed or not."""

    def on_term(self, term: int) -> None:
        """Note a coordinator's term; from now on, orders of lower terms are refused."""
        if term and term not in self.terms:
            self.terms = (*self.terms, term)[-KEPT_TERMS:]
        if term > self.term:
            self.term, self.order, self.newest = term, 0, 0

    def on_checkpoint(self, checkpoint: work.Checkpoint) -> None:
        self.on_term(checkpoint.term)
        if checkpoint.founded:
            self.founded = max(self.founded, checkpoint.term)

    def check(self, order: work.WorkOrder) -> bool:
        """Return whether to follow an order; False if a later order has arrived before it.

        Raises:
            OldTermError: a coordinator with a higher term is known.
        """
        if order.term < self.term:
            raise OldTermError(term=order.term, ruling=self.term)
        self.on_term(order.term)
        if order.order < self.newest:
            return False
        self.newest = order.order
        return True


class _WaitingOrder(msgspec.Struct, frozen=True):
    """An order that waits for its sensor model."""

    question: Any
    order: work.WorkOrder
    settings: FilterSettings


class Worker:
    """One worker: its jobs, the coordinator that it follows, and the map's sensor model.

    No method waits: the map and past scans are requested by an instruction, and arrive later.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._table, self._fence = JobTable(name), TermFence()
        self._map: MapMessage | None = None
        self._model: SensorModel | None = None
        self._model_digest = self._ordered_map = ""
        self._preparing = False
        """Whether the map is being fetched, or its sensor model built."""
        self._waiting: _WaitingOrder | None = None
        self._ordered: FilterSettings | None = None
        self._live = AS_STARTED
        """Settings of the newest scan, which override those of the order."""
        self._in_force: FilterSettings | None = None
        """Settings of all jobs: those of the order, changed by those of the scan; None: unknown."""
        self._held: deque[Scan] = deque(maxlen=RECENT_SCANS_OF_WAITING)
        """Scans that wait for a sensor model with other settings."""
        self._fetching: MissingScans | None = None
        self._dropped = 0

    @property
    def jobs(self) -> int:
        return len(self._table.summary())

    @property
    def needs_scans(self) -> bool:
        """Whether this worker has a job, or an order that waits for a sensor model."""
        return self.jobs > 0 or self._waiting is not None

    @property
    def searches(self) -> bool:
        return self._table.searches

    def on_checkpoint(self, checkpoint: work.Checkpoint) -> list[Instruction]:
        self._fence.on_checkpoint(checkpoint)
        return []

    def search(self) -> list[Instruction]:
        """Compute one slice of a search; call it while no event waits."""
        return [*self._table.search_on()]

    def on_advice_query(self, question: Any, asked: AdviceQuestion) -> list[Instruction]:
        model, settings = self._model, self._in_force or self._ordered
        scan = self._table.scan_of(asked.step)
        if model is None or settings is None or asked.map_digest != self._model_digest:
            problem = "the worker has no map yet"
        elif scan is None:
            problem = f"the worker has no scan of step {asked.step}: ask again"
        elif (wrong := ViewMemory(asked.views).problem) is not None:
            problem = wrong
        else:
            return [Advise(question, asked, scan, model, settings)]
        return [Answer(question, Advice(sender=self._name, note=problem))]

    # --- scans

    def on_scan(self, scan: Scan, dropped: int = 0) -> list[Instruction]:
        """Process a step of the bridge.

        `dropped` counts the scans that this process dropped from a full inbox since its start.
        """
        if not self.needs_scans:
            return []
        if self._is_of_another_map(scan):
            detail = f"step {scan.step} is of map {printable(scan.map_digest, 12)}"
            return [Warn(Cause.OTHER_MAP, detail)]
        if not self._is_prepared(scan):
            self._held.append(scan)
            return self._continue()
        if (lost := self._table.lost_before(scan)) is None:
            return [*self._table.on_scan(scan)]
        was_dropped, self._dropped = dropped > self._dropped, dropped
        if was_dropped:  # this process was too slow, so that to fetch them would not help
            return [*self._table.on_scan(scan)]
        self._table.wait_for(lost)
        reports = self._table.on_scan(scan)
        return [*reports, *self._fetch(self._table.missing(), LOST_SCANS_TIMEOUT_S)]

    def _is_prepared(self, scan: Scan) -> bool:
        """Apply a scan's settings; return False if they need another sensor model first."""
        if self._held:
            return False
        self._live = scan.settings
        if self._model is None or self._ordered is None:
            return True
        settings = filter_with(self._ordered, scan.settings)
        if self._model.settings != settings.sensor:
            return False
        if self._in_force != settings:
            self._in_force = settings
            self._table.use(self._model, settings)
        return True

    def _is_of_another_map(self, scan: Scan) -> bool:
        return self._map is not None and scan.map_digest != self._map.digest

    def _fetch(self, missing: MissingScans | None, timeout_s: float) -> list[Instruction]:
        """Request past scans, unless the same request is under way; a new one replaces it."""
        if missing is None or missing == self._fetching:
            return []
        self._fetching = missing
        return [FetchScans(missing, timeout_s)]

    def on_no_history(self, missing: MissingScans, problem: str) -> list[Instruction]:
        return [Warn(Cause.NO_HISTORY, problem), *self.on_history(missing, ())]

    def on_history(self, missing: MissingScans, scans: tuple[Scan, ...]) -> list[Instruction]:
        if missing != self._fetching:
            return []  # an answer to a request that a later one has replaced
        self._fetching = None
        self._table.wait_for(None)
        fitting = [scan for scan in scans if not self._is_of_another_map(scan)]
        return [*self._catch_up(fitting), *(self._continue() if self._held else ())]

    def _catch_up(self, history: Iterable[Scan] = ()) -> list[Report]:
        """Advance all jobs that do not wait to the newest scan, each step with its settings.

        Steps that need another sensor model wait for it, and so do those after them.
        """
        reports, later = list[Report](), list(self._held)
        self._held.clear()
        for scan in (scans := self._table.rewind(history)):
            if self._is_prepared(scan):
                reports += self._table.on_scan(scan)
            else:
                self._held.append(scan)
        self._held += (scan for scan in later if not scans or scan.step > scans[-1].step)
        return reports

    # --- orders

    def on_order(self, question: Any, order: work.WorkOrder) -> list[Instruction]:
        """Follow an order as soon as there is a sensor model for it, and answer the query."""
        try:
            settings = converted(order.filter_settings, FilterSettings)
            if not self._fence.check(order):
                return self._overtaken(question, order)
        except (OldTermError, msgspec.ValidationError) as error:
            return self.refuse(question, error)
        before, self._waiting = self._waiting, _WaitingOrder(question, order, settings)
        # The coordinator no longer expects its previous order to be followed.
        answered = [Answer(before.question, self._answer())] if before else []
        return [*answered, *self._continue()]

    def _overtaken(self, question: Any, order: work.WorkOrder) -> list[Instruction]:
        detail = f"order {order.order} after {self._fence.newest}"
        return [Warn(Cause.ORDER_OVERTAKEN, detail), Answer(question, self._answer())]

    def _continue(self) -> list[Instruction]:
        """Follow the waiting order and take the held scans, or request what they need."""
        waiting, wanted = self._waiting, self._wanted()
        if wanted is None:
            return []
        settings, digest = wanted
        sensor = filter_with(settings, self._live).sensor
        has_model = self._model and (self._model_digest, self._model.settings) == (digest, sensor)
        if waiting is not None and (has_model or not waiting.order.begin):
            return [*self._follow(waiting), *self._continue()]
        if has_model:
            held = list(self._held)
            self._held.clear()
            return [do for scan in held for do in self.on_scan(scan, self._dropped)]
        if self._preparing:
            return []
        self._preparing = True
        if self._map is None or self._map.digest != digest:
            return [FetchMap()]
        return [BuildModel(self._map, sensor)]

    def _wanted(self) -> tuple[FilterSettings, str] | None:
        """Return the settings and the map's digest of the waiting order, or of the last one."""
        if self._waiting is not None:
            return self._waiting.settings, self._waiting.order.map_digest
        return (self._ordered, self._ordered_map) if self._ordered and self._ordered_map else None

    def on_map_failure(self, error: Exception) -> list[Instruction]:
        """Refuse the waiting order, because the map or its model cannot be had."""
        self._preparing, self._map = False, None
        return self._refuse_waiting(error)

    def on_model(self, map_digest: str, model: SensorModel) -> list[Instruction]:
        self._preparing, self._model, self._model_digest = False, model, map_digest
        return self._continue()

    def on_map(self, message: MapMessage) -> list[Instruction]:
        self._preparing, wanted = False, self._wanted()
        if wanted is None:
            return []
        if message.digest != wanted[1]:
            error = MapMismatchError(worker=self._name, expected=wanted[1], found=message.digest)
            return self._refuse_waiting(error)  # the known map is still that of the jobs
        self._map = message
        return self._continue()

    def _follow(self, waiting: _WaitingOrder) -> list[Instruction]:
        self._waiting = None
        order = waiting.order
        try:
            if not self._fence.check(order):  # checked again, as the order may have waited
                return self._overtaken(waiting.question, order)
            if self._model is not None:
                self._table.follow(order, self._model, filter_with(waiting.settings, self._live))
                self._in_force = None  # the new jobs' settings may differ from the others'
            self._ordered, self._ordered_map = waiting.settings, order.map_digest
        except (OldTermError, ValueError) as error:
            return self.refuse(waiting.question, error)
        again, is_first = list[Report](), self._fence.order == 0
        if order.repeat_after is not None:
            again = self._table.reports.since(order.repeat_after, searches=is_first)
        self._fence.order = order.order
        missing = self._table.missing()
        self._table.wait_for(missing)
        return [
            Answer(waiting.question, self._answer()),
            *again,
            *self._catch_up(),
            *self._fetch(missing, HISTORY_TIMEOUT_S),
        ]

    def _refuse_waiting(self, error: Exception) -> list[Instruction]:
        waiting, self._waiting = self._waiting, None
        return self.refuse(waiting.question, error) if waiting else []

    def refuse(self, question: Any, error: Exception) -> list[Instruction]:
        """Refuse an order, which may be one that cannot be decoded."""
        problem = str(error)
        return [Warn(_cause_of(error), problem), Answer(question, self._answer(problem))]

    # --- answers

    def _answer(self, problem: str = "") -> work.OrderAnswer:
        return work.OrderAnswer(
            sender=self._name,
            order=self._fence.order,
            term=self._fence.term,
            jobs=self._table.summary(),
            problem=problem,
        )

    def on_take_over(self, question: Any, take_over: work.TakeOver) -> list[Instruction]:
        """Answer with the `WorkerState` for a coordinator that takes over."""
        self._fence.on_term(take_over.term)
        state = work.WorkerState(
            sender=self._name,
            term=self._fence.term,
            holds=self._table.holds(),
            terms=self._fence.terms,
            founded=self._fence.founded,
        )
        return [Answer(question, state)]


def _cause_of(error: Exception) -> AnyCause:
    if isinstance(error, MalformedMessageError):
        return error.cause
    known = {MapMismatchError: Cause.ORDER_OTHER_MAP, OldTermError: Cause.OLD_TERM}
    return known.get(type(error), Cause.ORDER_REFUSED)
