"""The whole state of a coordinator between two events as typed data, without particles and beams.

A checkpoint leaves out what workers report again after a take-over. A replay has no workers to
ask, so a snapshot also keeps open steps, deadlines and unanswered orders. Reading one creates only
the data types below: the coordinator is built from its settings, and its attributes are set.
"""

from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping
from operator import attrgetter
from types import MappingProxyType
from typing import Any

import msgspec

from coordinator import order_delivery, slow_workers
from coordinator.belief.cluster_set import Cluster
from coordinator.belief.outcome import Outcome
from coordinator.belief.prior_pose import PriorPose
from coordinator.belief.search_course import SearchCourse
from coordinator.belief.search_evidence import SearchEvidence
from coordinator.belief.search_pool import SearchPool
from coordinator.commands import CommandsState
from coordinator.coordinator import Coordinator
from coordinator.events import WorkerSnapshot
from coordinator.free_ground import FreeGround
from coordinator.jobs import PlacedJob
from coordinator.pose_tracker import LatencyEstimator
from coordinator.recorder.records import Started, without_bulk
from coordinator.step_collector import OpenStep, StepCollectorState
from particle_filter.evidence_model import UsualFit
from particle_filter.off_map import MapQuality
from particle_filter.view_memory import ViewMemory
from protocol.job_events import JobEvent, NumberedEvent
from protocol.live_settings import LiveSettings
from protocol.message import Covariance, PoseTuple
from protocol.work import Checkpoint, Job, Report, SearchReport


def _search_at(path: str) -> dict[str, dict[str, Any]]:
    """What changes in a `SearchCourse`."""
    return {
        path: {
            "begun": int,
            "evidence": SearchEvidence,
            "_next_step": int,
            "_means": dict[int, dict[str, PoseTuple]],
        },
        f"{path}._pool": {
            "search": int,
            "first_step": int,
            "progress": float,
            "_reports": dict[int, dict[str, SearchReport]],
        },
    }


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
        },
        "_state.ensemble": {
            "_prior_pose": PriorPose | None,
            "_seen": ViewMemory,
            "_found": bool,
            "_begin": dict[str, Job],
            "_events": list[JobEvent],
        },
        "_state.ensemble.clusters": {
            "_clusters": dict[int, Cluster],
            "_next_cluster": int,
            "log_elsewhere": float,
            "log_off_map": float,
            "quality": MapQuality,
            "fit": UsualFit,
        },
        **_search_at("_state.ensemble._search"),
        "_state.ensemble._decoy": {"places": tuple[Cluster, ...]},
        **_search_at("_state.ensemble._decoy._search"),
        "_state.placement.jobs": {
            "_jobs": dict[str, PlacedJob],
            "_newest_epoch": int,
            "_missed_until_ns": dict[str, int],
        },
        "_state.placement.delivery": {
            "_workers": dict[str, order_delivery._Record],
            "_orders": int,
        },
        "_state.placement._stragglers": {
            "_records": dict[str, slow_workers._Record],
            "_proven": set[str],
        },
        "_state.placement._silent_shards": {
            "_reports": dict[str, int],
            "_steps": dict[str, int],
            "_took_ns": dict[str, int],
            "_given_up": dict[str, int],
            "_watches": dict[str, slow_workers._Watch],
            "_looked_ns": int,
        },
        "_state.collector": {
            "_open": dict[int, OpenStep],
            "_late": list[SearchReport],
            "state": StepCollectorState,
            "_base": int | None,
        },
        "_state.pose": {
            "_outcome": Outcome | None,
            "_odom_now": PoseTuple,
            "_stamp_ns": int,
            "_arrived_ns": int | None,
            "_told_ns": int,
            "_has_heard": bool,
            "_waiting_ns": dict[int, int],
            "_scan_ns": int | None,
            "_by_scan": bool,
        },
        "_state.pose.history": {"_poses": list[tuple[int, PoseTuple]]},
        "_state.pose._driven": {"_counted": PoseTuple | None, "gates": float},
        "_state.pose._since_step": {
            "_covariance": Covariance,
            "_step": PoseTuple,
            "_piece": PoseTuple,
            "_now": PoseTuple,
        },
        "_state.pose._lateness": {
            "_begun_ns": int | None,
            "_least_ns": int,
            "_least_before_ns": int,
        },
        "_state.event_log": {
            "_kept": list[NumberedEvent],
            "_count": int,
            "_news": list[NumberedEvent],
        },
        "_state.commands": {"state": CommandsState},
        "_state.overload": {"_waits_ns": list[int], "_overloaded": bool},
        "_state._map_changes": {"_digest": str, "_step": int, "_in_a_row": int},
        "": {"_linked": bool},
    }
)
"""What changes in each part of a coordinator; all other attributes follow from its settings.
`test_snapshot.py` fails when one is missing."""


def _search_pool(course: SearchCourse, part: Any) -> SearchPool:
    return course.new_pool(part.search, part.first_step)


OPTIONAL: Mapping[str, Callable[[Any, Any], object]] = MappingProxyType(
    {
        "_state.ensemble._search._pool": _search_pool,
        "_state.ensemble._decoy._search._pool": _search_pool,
        "_state.pose._lateness": lambda _owner, _part: LatencyEstimator(),
    }
)
"""Parts that are None at times, and how they are made."""


def _struct_of(path: str) -> Any:
    fields = list(ATTRIBUTES[path].items())
    kind = msgspec.defstruct(path or "coordinator", fields, forbid_unknown_fields=True)
    return kind | None if path in OPTIONAL else kind


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
        if path in OPTIONAL:
            owner, _, name = path.rpartition(".")
            parent = _part(coordinator, owner)
            setattr(parent, name, values and OPTIONAL[path](parent, values))
        for name in attributes if values else ():
            part = _part(coordinator, path)
            setattr(part, name, _like(getattr(part, name), getattr(values, name)))
    return coordinator


def _part(coordinator: Coordinator, path: str) -> Any:
    return attrgetter(path)(coordinator) if path else coordinator


def _values(part: Any, names: Iterable[str]) -> dict[str, Any] | None:
    if part is None:
        return None
    values = {name: getattr(part, name) for name in names}
    return {
        name: without_bulk(list(value) if isinstance(value, deque) else value)
        for name, value in values.items()
    }


def _like(now: object, value: Any) -> Any:
    """The value in the container that the attribute has; MessagePack knows only lists and maps."""
    match now:
        case deque():
            return deque(value, now.maxlen)
        case Counter():
            return Counter(value)
        case _:
            return value
