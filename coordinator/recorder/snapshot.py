"""The whole state of a coordinator between two events as typed data, without particles and beams.

A checkpoint leaves out what workers report again after a take-over. A replay has no workers to
ask, so a snapshot also keeps open steps, deadlines and unanswered orders. Reading one creates only
the data types below: the coordinator is built from its settings, and its attributes are set.
"""

from collections import Counter
from collections.abc import Iterable, Mapping
from operator import attrgetter
from types import MappingProxyType
from typing import Any

import msgspec

from coordinator.belief.ensemble import Ensemble
from coordinator.belief.outcome import Outcome
from coordinator.commands import Commands
from coordinator.coordinator import Coordinator
from coordinator.events import WorkerSnapshot
from coordinator.free_ground import FreeGround
from coordinator.jobs import Jobs
from coordinator.order_delivery import OrderDelivery
from coordinator.pose_tracker import PoseTracker
from coordinator.recorder.records import Started, without_bulk
from coordinator.slow_workers import SilentShards, StragglerPolicy
from coordinator.state import EventLog, MapChangeDetector, OverloadDetector
from coordinator.step_collector import StepCollector
from protocol.live_settings import LiveSettings
from protocol.work import Checkpoint, Report

ATTRIBUTES: Mapping[str, Mapping[str, Any]] = MappingProxyType(
    {
        "_term": {
            "_number": int,
            "_begun": bool,
            "_outranked_by": int | None,
            "_claimed": int | None,
            "_claimed_ns": int,
        },
        "_take_over": {"_early_reports": list[tuple[Report, str]]},
        "_take_over._recovery": {
            "_asked_ns": dict[str, int | None],
            "_told": dict[str, WorkerSnapshot],
            "_heard": list[Checkpoint],
            "_kept": Checkpoint | None,
            "_is_of_this_life": bool,
            "_founded": int,
        },
        "_checkpoints": {"_last": Checkpoint | None, "_last_ns": int},
        "_step_resets": {
            "_last": tuple[int, int] | None,
            "_in_a_row": int,
            "_newer_in_a_row": int,
        },
        "_state": {
            "live": LiveSettings,
            "outcome": Outcome | None,
            "counters": dict[str, int],
            "steps_applied": int,
            "reports_missing": int,
            "_map_digest": str,
            "_ground": FreeGround | None,
            "_map_asked_ns": int | None,
            "_founded": bool,
            "_changed": bool,
            "ensemble": Ensemble,
            "collector": StepCollector,
            "pose": PoseTracker,
            "event_log": EventLog,
            "commands": Commands,
            "overload": OverloadDetector,
            "_map_changes": MapChangeDetector,
        },
        "_state.placement": {
            "jobs": Jobs,
            "delivery": OrderDelivery,
            "_stragglers": StragglerPolicy,
            "_silent_shards": SilentShards,
        },
        "": {"_linked": bool},
    }
)
"""What changes in each part of a coordinator; all other attributes follow from its settings.
`test_snapshot.py` fails when one is missing."""


def _struct_of(path: str) -> Any:
    fields = list(ATTRIBUTES[path].items())
    return msgspec.defstruct(path or "coordinator", fields, forbid_unknown_fields=True)


_SNAPSHOTS: msgspec.msgpack.Decoder[tuple[Any, ...]] = msgspec.msgpack.Decoder(
    tuple[*map(_struct_of, ATTRIBUTES)]  # type: ignore[misc] # made at run time
)


def freeze(coordinator: Coordinator) -> bytes:
    """Encode all that it knows."""
    parts = ((_part(coordinator, path), names) for path, names in ATTRIBUTES.items())
    return msgspec.msgpack.encode([_values(part, names) for part, names in parts])


def thaw(started: Started, data: bytes) -> Coordinator:
    """Make a coordinator that decides from here on just as the other one.

    Args:
        started: what the other one was made with.
        data: what `freeze` returned.

    Raises:
        ValueError: the bytes are no snapshot of this version.
    """
    try:
        snapshot = _SNAPSHOTS.decode(data)
    except (msgspec.DecodeError, RecursionError) as error:
        raise ValueError(f"not a coordinator's snapshot: {error}") from None
    coordinator = started.coordinator()
    for (path, attributes), values in zip(ATTRIBUTES.items(), snapshot, strict=True):
        for name in attributes:
            part = _part(coordinator, path)
            setattr(part, name, _like(getattr(part, name), getattr(values, name)))
    return coordinator


def _part(coordinator: Coordinator, path: str) -> Any:
    return attrgetter(path)(coordinator) if path else coordinator


def _values(part: Any, names: Iterable[str]) -> dict[str, Any]:
    return {name: without_bulk(getattr(part, name)) for name in names}


def _like(now: object, value: Any) -> Any:
    """The value in the container that the attribute has; MessagePack knows only lists and maps."""
    return Counter(value) if isinstance(now, Counter) else value
