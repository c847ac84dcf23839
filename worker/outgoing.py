"""What a worker has decided, carried out over Zenoh; what comes of it comes through the inbox."""

import logging
import time
from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import zenoh

from grid_maps.map_message import from_message
from particle_filter.grid_search import free_leaves
from process_runtime.logs import CauseCounter
from protocol import keys
from protocol.errors import UnreachableError
from worker.events import HistoryFailed, MapFailed, ModelBuilt
from worker.instructions import (
    Answer,
    BuildModel,
    FetchMap,
    FetchScans,
    Instruction,
    PublishReport,
    Warn,
)
from worker.map_model import sensor_model
from zenoh_link.health import HealthReporter
from zenoh_link.inbox import Inbox
from zenoh_link.wire import Asked, Event, Publisher, Received, ask_later

MAP_TIMEOUT_S = 30.0
ASK_AGAIN_WITHIN_S = 0.5
"""Just after a link came up, a query for past scans finds nobody; it is repeated so long."""
ANSWERS = "answer"
"""As what the inbox counts what comes of fetching and building."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Fetched:
    """An answer of the bridge's, still undecoded."""

    asked: FetchMap | FetchScans
    payload: bytes


@dataclass(frozen=True)
class Built:
    """The thread that builds sensor models has done with one."""

    outcome: Future[ModelBuilt]


WorkerInbox = Inbox[Event | Fetched | Built | MapFailed | HistoryFailed]


class Outgoing:
    """Publishes, answers, fetches and builds; never waits for anybody but a slow link.

    Args:
        name: the worker's own.
        session: the process's own.
        inbox: for what comes of fetching and building.
        health: counts reports.
        causes: counts and logs what went wrong.
        cache_folder: where computed fields are kept.
    """

    def __init__(
        self,
        name: str,
        session: zenoh.Session,
        inbox: WorkerInbox,
        health: HealthReporter,
        causes: CauseCounter,
        cache_folder: Path,
    ) -> None:
        self._session, self._inbox, self._cache_folder = session, inbox, cache_folder
        self._health, self._causes = health, causes
        self._reports = Publisher(session, keys.worker_report(name), may_wait=True)
        self._builder = ThreadPoolExecutor(1, thread_name_prefix="sensor-model")
        self._questions: dict[int, Asked] = {}
        self._asked = 0
        self._unanswered: deque[tuple[FetchScans, float]] = deque()

    def number(self, asked: Asked) -> int:
        """Keep a question until its answer is carried out."""
        self._asked += 1
        self._questions[self._asked] = asked
        return self._asked

    @property
    def asks_again(self) -> bool:
        """Whether nobody was there to be asked for scans, so that it must be repeated soon."""
        return bool(self._unanswered)

    def ask_again(self) -> None:
        """Repeat what nobody has answered."""
        for _ in range(len(self._unanswered)):
            self._fetch_scans(*self._unanswered.popleft())

    def carry_out(self, instructions: Iterable[Instruction]) -> None:
        """Do what was decided, in its order."""
        for instruction in instructions:
            match instruction:
                case PublishReport(report):
                    self._reports.put(report)
                    self._health.happened("reports")
                case Answer(question, message):
                    self._questions.pop(question).answer(message)
                case FetchMap():
                    self._fetch_map(instruction)
                case BuildModel():
                    self._build(instruction)
                case FetchScans():
                    self._fetch_scans(instruction, time.monotonic() + ASK_AGAIN_WITHIN_S)
                case Warn(cause, detail):
                    self._causes.warn(_log, cause, detail, time.monotonic())

    def _fetch_map(self, fetch: FetchMap) -> None:
        def on_failure(refused: str) -> None:
            problem = f"no answer on {keys.MAP!r}: {refused or 'nobody is there'}"
            error = UnreachableError(who=keys.MAP, problem=problem, waited_s=MAP_TIMEOUT_S)
            self._inbox.put_newest(ANSWERS, MapFailed(error))

        self._ask(keys.MAP, fetch, on_failure, MAP_TIMEOUT_S)

    def _fetch_scans(self, fetch: FetchScans, until_s: float) -> None:
        def on_failure(refused: str) -> None:
            if time.monotonic() < until_s:
                self._unanswered.append((fetch, until_s))
            else:
                problem = refused or "nobody is there"
                self._inbox.put_newest(ANSWERS, HistoryFailed(fetch.missing, problem))

        selector = keys.scan_history(fetch.missing.first, fetch.missing.last)
        self._ask(selector, fetch, on_failure, fetch.timeout_s)

    def _build(self, build: BuildModel) -> None:
        def built() -> ModelBuilt:
            model = sensor_model(from_message(build.map), build.settings, self._cache_folder)
            free_leaves(model.grid, model.pyramid.leaf_cells)  # kept for searches: it takes long
            return ModelBuilt(build.map.digest, model)

        outcome = self._builder.submit(built)
        outcome.add_done_callback(lambda done: self._inbox.put_newest(ANSWERS, Built(done)))

    def _ask(
        self,
        selector: str,
        fetch: FetchMap | FetchScans,
        on_failure: Callable[[str], None],
        timeout_s: float,
    ) -> None:
        def on_answer(answer: Received) -> None:
            self._inbox.put_newest(ANSWERS, Fetched(fetch, answer.payload))

        ask_later(self._session, selector, on_answer, on_failure, timeout_s=timeout_s)
