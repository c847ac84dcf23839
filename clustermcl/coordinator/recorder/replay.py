"""Replays a flight recording with the real coordinator, and compares the beliefs."""

from collections.abc import Generator, Iterable, Iterator
from dataclasses import dataclass, field
from itertools import groupby, zip_longest
from pathlib import Path
from typing import TypeAlias, TypeVar

import msgspec

from clustermcl.coordinator.coordinator import Coordinator
from clustermcl.coordinator.recorder import records
from clustermcl.coordinator.recorder.ring import EVENTS, HEAD, files_in, series_of
from clustermcl.protocol import conversion
from clustermcl.protocol.answers import Belief
from clustermcl.protocol.codec import encode
from clustermcl.protocol.errors import RecordingError
from clustermcl.protocol.work import Checkpoint
from clustermcl.recordings.run_log import BELIEF, LogMessage, RunLogReader, decoded


@dataclass(frozen=True)
class CoordinatorActs:
    """A coordinator began to lead."""

    sender: str
    term: int
    after_step: int | None
    """The last step of its predecessor; None: it began without a state."""


@dataclass(frozen=True)
class Believed:
    """A belief was published."""

    belief: Belief
    same: bool | None
    """Whether it equals the recorded belief bit for bit; None: the recording ends before it."""


Happening: TypeAlias = records.Happened | CoordinatorActs | Believed


def replayed(folder: Path, version: str) -> Iterator[tuple[int, Happening]]:
    """Replay the recordings in a folder, one coordinator after another by their start.

    A file in the folder, or the folder above it, will do. Yields the wall clock [ns] and what
    happened.

    Raises:
        RecordingError: there is no recording, an unreadable one, or one of another version.
    """
    is_empty = True
    for _, series in groupby(files_at(folder), series_of):
        coordinator = yield from _replayed_series(series, version)
        is_empty = is_empty and coordinator is None
    if is_empty:
        raise RecordingError(folder, "all files in it are cut off at their beginning")


def _replayed_series(
    files: Iterable[Path], version: str
) -> Generator[tuple[int, Happening], None, Coordinator | None]:
    """Replay the files of one coordinator, oldest first; return it at the end.

    If events before a file are missing, the replay continues with the state in the file's head.
    """
    coordinator: Coordinator | None = None
    events = wall_ns = 0
    for path in files:
        log = RunLogReader(path)
        for entry in _entries(log, version):
            if isinstance(entry, records.Head):
                head, wall_ns, missing = entry, entry.wall_ns, entry.first_event - events
                if missing:
                    about = f"{missing} events before {path.name}"
                    yield wall_ns, records.Happened("not recorded", about)
                if coordinator is None or missing:
                    what = "not a coordinator's snapshot"
                    coordinator = _unpacked(path, what, head.snapshot, Coordinator)
                    events = head.first_event
                    yield wall_ns, records.Happened("recording", path.name)
            else:
                assert coordinator is not None  # each file begins with a head
                wall_ns, events = head.wall_ns + entry.recorded.now_ns - head.now_ns, events + 1
                for happening in _replay(path, coordinator, entry, events):
                    yield wall_ns, happening
        if log.cut:
            wall_ns = wall_ns or path.stat().st_mtime_ns  # cut off before its head
            yield wall_ns, records.Happened("cut off", f"{path.name}: {log.cut}")
    return coordinator


def _replay(
    path: Path, coordinator: Coordinator, entry: "_Entry", number: int
) -> Iterator[Happening]:
    """Pass an event, the coordinator's `number`-th, to the coordinator; compare the beliefs."""
    recorded, had_begun = entry.recorded, coordinator.term.begun
    yield from records.happened(recorded.event)
    try:
        instructions = coordinator.handle(recorded.event, recorded.now_ns)
    except Exception as error:  # a recorded bug, or a forged file
        problem = f"the coordinator fails at event {number}: {type(error).__name__}: {error}"
        raise RecordingError(path, problem) from error
    beliefs = [do for do in instructions if isinstance(do, Belief)]
    if coordinator.term.begun and not had_begun:
        first = next(do for do in instructions if isinstance(do, Checkpoint))
        # A first belief shows that it took over.
        yield CoordinatorActs(first.sender, first.term, beliefs[0].step if beliefs else None)
    yield from records.happened_to(instructions)
    for belief, written in zip_longest(beliefs, entry.beliefs):
        if belief is None:  # published only in the recording
            yield Believed(written, same=False)
        else:
            same = written is not None and encode(belief) == encode(written)
            yield Believed(belief, same if entry.is_followed else None)


@dataclass
class _Entry:
    """An event, and the beliefs published because of it."""

    recorded: records.RecordedEvent
    beliefs: list[Belief] = field(default_factory=list)
    is_followed: bool = False
    """Whether the file contains anything after the event."""


def _entries(log: RunLogReader, version: str) -> Iterator[records.Head | _Entry]:
    """Yield the head of a file, then its events."""
    entry: _Entry | None = None
    for number, message in enumerate(log.messages()):
        if number == 0:
            yield _head(log.path, message, version)
        elif message.topic == EVENTS:
            for recorded in _unpacked(log.path, EVENTS, message.data, list[records.RecordedEvent]):
                if entry is not None:
                    entry.is_followed = True
                    yield entry
                entry = _Entry(recorded)
        elif entry is not None and message.topic == BELIEF:
            entry.is_followed = True
            entry.beliefs.append(decoded(message, Belief, log.path))
    if entry is not None:
        yield entry


class _Version(msgspec.Struct, frozen=True):
    version: str


T = TypeVar("T")


def _head(path: Path, message: LogMessage, version: str) -> records.Head:
    if message.topic != HEAD:
        raise RecordingError(
            path, f"it has no events of a coordinator; show it with: clustermcl view {path}"
        )
    found = _unpacked(path, HEAD, message.data, _Version).version
    if found != version:
        problem = f"recorded by version {found}, this is {version}: replay it with that version"
        raise RecordingError(path, problem)
    return _unpacked(path, HEAD, message.data, records.Head)


def _unpacked(path: Path, what: str, data: bytes, kind: type[T]) -> T:
    try:
        return conversion.decoded(data, kind)
    except (ValueError, RecursionError) as error:  # msgspec's errors are ValueErrors
        raise RecordingError(path, f"{what}: {error}") from None


def files_at(path: Path) -> list[Path]:
    """Return the files of a recording, oldest first.

    Raises:
        RecordingError: there is none at the path, or more than one.
    """
    if path.is_file():
        beside = files_in(path.parent)
        return beside if path in beside else [path]  # any other kind is refused when it is read
    if found := files_in(path):
        return found
    if not path.is_dir():
        problem = "neither a folder nor a file" if path.exists() else "no such folder"
        raise RecordingError(path, f"{problem}; check the path")
    robots = [each for each in sorted(path.iterdir()) if each.is_dir() and files_in(each)]
    if len(robots) == 1:
        return files_in(robots[0])
    if robots:
        names = ", ".join(each.name for each in robots)
        raise RecordingError(path, f"it contains several flight recordings: name one of {names}")
    raise RecordingError(path, "it contains no flight recording")
