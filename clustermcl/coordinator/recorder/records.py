"""The records of a flight recording, without particles and beams.

A coordinator computes no belief from particles or beams, so a replay does not need them. Without
them, a step is a hundred times smaller. A checkpoint stays as published: most have no particles.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import msgspec
import numpy as np
from msgspec.structs import replace

from clustermcl.belief.commands import command_remark
from clustermcl.coordinator import events
from clustermcl.coordinator.coordinator import Coordinator
from clustermcl.coordinator.instructions import FetchScans, Instruction
from clustermcl.protocol.answers import CommandDone
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.causes import Cause
from clustermcl.protocol.found_places import FoundPlaces
from clustermcl.protocol.job_events import Began, JobEvents, Remark, event_text, probability_of
from clustermcl.protocol.message import Covariance, PoseTuple
from clustermcl.protocol.steps import Scan
from clustermcl.protocol.work import Particles


class Head(msgspec.Struct, frozen=True, kw_only=True):
    """The first message of each file, from which a replay makes the coordinator."""

    version: str
    """Version of the software; only the same version can replay the file."""
    now_ns: int
    """Time by the clock of all events [ns]."""
    wall_ns: int
    """The same time by the wall clock [ns]."""
    first_event: int
    """Number of earlier events of this coordinator, recorded or not."""
    snapshot: bytes
    """The coordinator before the next event; see `freeze`."""


class RecordedEvent(msgspec.Struct, frozen=True, array_like=True):
    """An event and its time, written before the coordinator processes the event."""

    now_ns: int
    event: events.Event


@dataclass(frozen=True)
class Happened:
    """An event in words."""

    kind: str
    about: str
    probability: float = 1.0
    """Of the cluster that began or ended."""


def happened(event: events.Event) -> Iterator[Happened]:
    """Yield the text of an event, if `clustermcl replay` prints it."""
    match event:
        case events.WorkerChanged(worker, how):
            yield Happened(f"worker {how}", worker)
        case events.LinkChanged(up):
            yield Happened("link is back" if up else "link lost", "to the router")
        case events.OrderAnswered(worker, answer) if answer.problem:
            yield Happened(Cause.ORDER_REFUSED, f"by {worker}: {answer.problem}")
        case events.CommandArrived(command):
            remark = command_remark(command)
            yield Happened(remark.cause, remark.detail)
    for remark in (remark for scan in scans_in(event) for remark in scan.remarks):
        yield Happened(remark.cause, remark.detail)


def scans_in(event: events.Event) -> Sequence[Scan]:
    match event:
        case events.ScanArrived(scan):
            return (scan,)
        case events.HistoryArrived(scans):
            return scans
    return ()


def happened_to(instructions: Iterable[Instruction]) -> Iterator[Happened]:
    """Yield the texts of instructions that `clustermcl replay` prints."""
    for instruction in instructions:
        match instruction:
            case FetchScans(first, last):
                until = "the newest" if last is None else last
                yield Happened("scans requested", f"{first} to {until}")
            case CommandDone(problem=problem) if problem:
                yield Happened("command refused", problem)
            case JobEvents(events=published):
                for one in published:
                    if isinstance(one.event, Remark):
                        continue  # `happened` has yielded it
                    what = "began" if isinstance(one.event, Began) else "ended"
                    yield Happened(what, event_text(one.event), probability_of(one.event))


def freeze(coordinator: Coordinator) -> bytes:
    """Encode a coordinator between two events, without particles and beams.

    Unlike a checkpoint, a snapshot contains open steps, deadlines and unanswered orders, because a
    replay cannot query workers.
    """
    return msgspec.msgpack.encode(without_bulk(coordinator))


def without_bulk(value: Any) -> Any:  # noqa: PLR0911 - a branch for each type
    """Return a copy of a value without particles and beams at any depth."""
    match value:
        case int() | float() | str() | None | (int() | float() | str(), *_):
            return value  # most values; a list that begins with a number or a name is small
        case Particles():
            poses, weights = _emptied(value.map_from_robot), _emptied(value.log_weights)
            return replace(value, map_from_robot=poses, log_weights=weights)
        case Scan():
            return replace(value, ranges=_emptied(value.ranges), others=())
        case FoundPlaces():
            none = ArrayBlob.of(np.zeros(len(value), np.int32), "int32")
            return replace(value, count=none, particles=_emptied(value.particles))
        case msgspec.Struct():
            fields = {name: getattr(value, name) for name in _bulky_fields(type(value))}
            changed = _changed(fields)
            return replace(value, **changed) if changed else value
        case tuple() | list():
            return type(value)(map(without_bulk, value))
        case dict():
            return value | _changed(value)
        case _:
            return value


def _emptied(blob: ArrayBlob) -> ArrayBlob:
    return replace(blob, shape=(0, *blob.shape[1:]), data=b"")


@cache
def _bulky_fields(kind: type[msgspec.Struct]) -> tuple[str, ...]:
    """Return the fields that may be large: all but numbers, names, poses and covariances."""
    small = (int, float, str, bool, PoseTuple, Covariance)
    return tuple(field.name for field in msgspec.structs.fields(kind) if field.type not in small)


def _changed(values: Mapping[Any, Any]) -> dict[Any, Any]:
    lighter = ((name, value, without_bulk(value)) for name, value in values.items())
    return {name: light for name, value, light in lighter if light is not value}
