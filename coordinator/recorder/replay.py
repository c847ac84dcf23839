"""A recording told to the real coordinator once more: what happened, and whether it is the same."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import chain, pairwise
from pathlib import Path
from typing import TypeAlias

from coordinator.coordinator import Coordinator
from coordinator.events import (
    CommandArrived,
    Event,
    LinkBack,
    LinkLost,
    OrderAnswered,
    ScanArrived,
    WorkerJoined,
    WorkerLeft,
    WorkerReturned,
)
from coordinator.instructions import (
    AnswerCommand,
    FetchScans,
    Instruction,
    PublishBelief,
    PublishCheckpoint,
    PublishEvents,
)
from coordinator.recorder.blocks import BlockReader, UnreadableError
from coordinator.recorder.records import BeliefsSaid, EventTold, Head, Record
from coordinator.recorder.ring import files_in, series_of
from coordinator.recorder.snapshot import thaw
from process_runtime.settings import BridgeSettings
from protocol.answers import Belief
from protocol.codec import encode
from protocol.errors import InputFileError
from protocol.job_events import Began, NumberedEvent, event_text


class FlightRecordingError(InputFileError):
    """A flight recording is missing, broken, of another version, or of another map."""


@dataclass(frozen=True)
class Happened:
    """Something other than a step."""

    kind: str
    about: str
    numbered: NumberedEvent | None = None
    """As it was published, where it is a job that began or ended."""


@dataclass(frozen=True)
class CoordinatorActs:
    """A coordinator has begun to act."""

    sender: str
    term: int
    after_step: int | None
    """The last step of the one it took over from; None: it began anew."""


@dataclass(frozen=True)
class Believed:
    """A belief was published."""

    belief: Belief
    same: bool | None
    """Whether the recorded belief is this one, bit for bit; None: the recording ends before it."""


Happening: TypeAlias = Happened | CoordinatorActs | Believed


def replayed(
    folder: Path, version: str, map_digest: str | None = None
) -> Iterator[tuple[int, Happening]]:
    """All that happened, coordinator by coordinator in the order of their terms.

    Args:
        folder: of the recording.
        version: of this software.
        map_digest: of the map that all of it must have happened in; None: any.

    Returns:
        When by the wall clock [ns], and what.

    Raises:
        FlightRecordingError: there is no recording, or one that cannot be read.
    """
    series = _by_term(folder, version)
    if all(_head_of(path, version) is None for files in series for path in files):
        raise FlightRecordingError(folder, "all that is in it is cut off within its beginning")
    for files in series:
        yield from SeriesReplay(files, version, map_digest).run()


class SeriesReplay:
    """Replays the files of one coordinator.

    Args:
        files: oldest first.
        version: of this software.
        map_digest: of the only map that is allowed; None: any.
    """

    def __init__(self, files: list[Path], version: str, map_digest: str | None) -> None:
        self._files, self._version, self._allowed_map = files, version, map_digest
        self._coordinator: Coordinator | None = None
        self._events = 0
        self._wall_ns = 0

    def run(self) -> Iterator[tuple[int, Happening]]:
        """When and what happened, in its order."""
        for happening in self._run():
            yield self._wall_ns, happening

    def _run(self) -> Iterator[Happening]:
        for path in self._files:
            with opened(path, self._version) as reader:
                if reader.head is not None:
                    yield from self._begin_file(path, reader.head)
                    yield from self._tell(path, reader.head, reader.records())
                if reader.cut_bytes or reader.head is None:
                    yield Happened("cut off", f"{path.name}, {reader.cut_bytes} bytes")

    def _begin_file(self, path: Path, head: Head) -> Iterator[Happening]:
        """Go on, or where events are missing, from what the file's head knows."""
        missing, self._wall_ns = head.first_event - self._events, head.wall_ns
        if self._coordinator is not None and not missing:
            return
        if missing:
            yield Happened("not recorded", f"{missing} events before {path.name}")
        try:
            started, snapshot = head.started, head.snapshot
            self._coordinator = thaw(started, snapshot) if snapshot else started.coordinator()
        except ValueError as error:
            raise FlightRecordingError(path, str(error)) from error
        self._events = head.first_event
        yield Happened("recording", f"{path.name}, made with {head.made_with}")

    def _tell(self, path: Path, head: Head, records: Iterator[Record]) -> Iterator[Happening]:
        """Tell the events of a file; the beliefs that were published follow their event."""
        coordinator = self._coordinator
        assert coordinator is not None  # the file's head has made one
        for record, after in pairwise(chain(records, (None,))):
            if not isinstance(record, EventTold):
                continue
            self._events += 1
            self._wall_ns = head.wall_ns + record.now_ns - head.now_ns
            yield from _before(record.event, coordinator)
            had_begun = coordinator.begun
            instructions = self._handled(path, coordinator, record)
            self._check_map(path, coordinator)
            if coordinator.begun and not had_begun:
                yield _begins(instructions)
            yield from _after(instructions)
            recorded = after.beliefs if isinstance(after, BeliefsSaid) else ()
            yield from self._believed(instructions, recorded, known=after is not None)

    def _handled(
        self, path: Path, coordinator: Coordinator, record: EventTold
    ) -> list[Instruction]:
        try:
            return coordinator.handle(record.event, record.now_ns)
        except Exception as error:  # a bug that was recorded, or a forged file
            problem = f"the coordinator fails at event {self._events}"
            raise FlightRecordingError(
                path, f"{problem}: {type(error).__name__}: {error}"
            ) from error

    def _believed(
        self, instructions: list[Instruction], recorded: tuple[Belief, ...], *, known: bool
    ) -> Iterator[Believed]:
        beliefs = [do.belief for do in instructions if isinstance(do, PublishBelief)]
        for index, belief in enumerate(beliefs):
            same = [encode(belief)] == [encode(one) for one in recorded[index : index + 1]]
            yield Believed(belief, same if known else None)
        for belief in recorded[len(beliefs) :]:  # told then, and not now
            yield Believed(belief, same=False)

    def _check_map(self, path: Path, coordinator: Coordinator) -> None:
        digest, allowed = coordinator.map_digest, self._allowed_map
        if digest and allowed is not None and digest != allowed:
            problem = f"recorded in the map {digest!r}, but this one is {allowed!r}"
            raise FlightRecordingError(path, problem)


def recorded_bridge(folder: Path, version: str) -> BridgeSettings | None:
    """The settings of the bridge that the first coordinator was started with: they name the map.

    Raises:
        FlightRecordingError: there is no recording, or one that cannot be read.
    """
    for path in (path for files in _by_term(folder, version) for path in files):
        if (head := _head_of(path, version)) is not None:
            return head.started.bridge
    return None


@contextmanager
def opened(path: Path, version: str) -> Iterator[BlockReader]:
    """Read a file of a recording.

    Raises:
        FlightRecordingError: it cannot be read.
    """
    try:
        with path.open("rb") as file:
            yield BlockReader(file, version)
    except OSError as error:
        raise FlightRecordingError(path, error.strerror or str(error)) from error
    except UnreadableError as error:
        raise FlightRecordingError(path, str(error)) from error


def _head_of(path: Path, version: str) -> Head | None:
    with opened(path, version) as reader:
        return reader.head


def _by_term(folder: Path, version: str) -> list[list[Path]]:
    """The files of each coordinator."""
    series: dict[int, list[Path]] = {}
    for path in files_in(folder):
        series.setdefault(series_of(path)[0], []).append(path)
    if not series:
        raise FlightRecordingError(folder, _nothing_in(folder))
    return sorted(series.values(), key=lambda files: _term(files, version))


def _nothing_in(folder: Path) -> str:
    if not folder.is_dir():
        return "there is no such folder"
    for below in sorted(folder.iterdir()):
        if below.is_dir() and files_in(below):
            return f"no flight recording is in it; there is one in {below}"
    return "no flight recording is in it"


def _term(files: list[Path], version: str) -> int:
    """Of the first belief; before there was one, the term that it meant to have."""
    meant = series_of(files[0])[0]
    for path in files:
        with opened(path, version) as reader:
            for record in reader.records():
                if isinstance(record, BeliefsSaid) and record.beliefs:
                    return record.beliefs[0].term
    return meant


def _begins(instructions: list[Instruction]) -> CoordinatorActs:
    """It begins to act: the checkpoint tells its term, a belief told again that it took over."""
    checkpoint = next(do.checkpoint for do in instructions if isinstance(do, PublishCheckpoint))
    steps = [do.belief.step for do in instructions if isinstance(do, PublishBelief)]
    return CoordinatorActs(checkpoint.sender, checkpoint.term, steps[0] if steps else None)


def _before(event: Event, coordinator: Coordinator) -> Iterator[Happened]:
    match event:
        case WorkerJoined(worker):
            yield Happened("worker joined", worker)
        case WorkerLeft(worker):
            yield Happened("worker left", worker)
        case WorkerReturned(worker):
            yield Happened("worker is back", worker)
        case LinkLost():
            yield Happened("link lost", "to the router")
        case LinkBack():
            yield Happened("link is back", "to the router")
        case OrderAnswered(worker, answer) if answer.problem:
            yield Happened("order refused", f"by {worker}: {answer.problem}")
        case ScanArrived(scan) if coordinator.map_digest not in ("", scan.map_digest):
            about = f"{scan.map_digest}, expected {coordinator.map_digest}"
            yield Happened("scan of another map", about)
        case CommandArrived(command):
            yield Happened("command", repr(command))


def _after(instructions: list[Instruction]) -> Iterator[Happened]:
    for instruction in instructions:
        match instruction:
            case FetchScans(first, last):
                until = "the newest" if last is None else last
                yield Happened("scans asked for", f"{first} to {until}")
            case AnswerCommand(done) if done.problem:
                yield Happened("command refused", done.problem)
            case PublishEvents(told):
                for one in told.events:
                    what = "began" if isinstance(one.event, Began) else "ended"
                    yield Happened(what, event_text(one.event), one)
