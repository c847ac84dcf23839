"""Messages with only what a test cares about."""

import math
from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np
from msgspec.structs import replace

from clustermcl.belief.ensemble import Ensemble
from clustermcl.belief.free_ground import FreeGround
from clustermcl.belief.part import handed_on
from clustermcl.belief.search_pool import Pool, Views
from clustermcl.coordinator.coordinator import Started
from clustermcl.filter.arrays import FREE
from clustermcl.filter.settings import BeliefSettings, FilterSettings
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.conversion import decoded
from clustermcl.protocol.found_places import FoundPlaces
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import Scan
from clustermcl.protocol.work import (
    Checkpoint,
    ElsewhereReport,
    Particles,
    Place,
    SearchReport,
    TrackReport,
    WorkOrder,
)
from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.runtime.settings import CoordinatorSettings


def started(**more: Any) -> Started:
    """With default settings, at time 0."""
    usual = Started(
        sender="coordinator",
        filter_settings=FilterSettings(),
        settings=CoordinatorSettings(),
        version="test",
        now_ns=0,
    )
    return replace(usual, **more)


def checkpoint(term: int, serial: int = 1, *, founded: bool = True, **more: Any) -> Checkpoint:
    """Of another coordinator."""
    usual = Checkpoint(sender="c", term=term, serial=serial, step=9, founded=founded, state=b"")
    return replace(usual, **more)


def work_order(number: int = 1, *, term: int = 0, **more: Any) -> WorkOrder:
    usual = WorkOrder(
        sender="coordinator", order=number, term=term, map_digest="map", filter_settings={},
        snapshot_every_steps=10, keep=(), begin=(),
    )  # fmt: skip
    return replace(usual, **more)


def successor_of(ensemble: Ensemble) -> Ensemble:
    """Return a copy as a successor has it: local fields have their default values."""
    return decoded(msgspec.msgpack.encode(handed_on(ensemble)), Ensemble)


def resumed(ensemble: Ensemble) -> Ensemble:
    other = successor_of(ensemble)
    other.use(ensemble.settings)
    return other


def literal_bayes(**more: object) -> BeliefSettings:
    """The paper's update: evidence of whole scans, no forgetting, no hypothesis for elsewhere."""
    rules: dict[str, object] = {
        "piece_evidence": 0.0,
        "kidnapping_probability": 0.0,
        "off_map_probability": 0.0,
        "least_probability": 0.0,
        "particles": 0,
    }
    return BeliefSettings(**rules | more)  # type: ignore[arg-type] # keywords of the test


def free_everywhere(map_digest: str = "map") -> FreeGround:
    """A map of 200 m x 200 m without a wall, about the origin."""
    ground = FreeGround.of(GridMap(np.full((200, 200), FREE, np.int8), 1.0, (-100.0, -100.0, 0.0)))
    return replace(ground, map_digest=map_digest)


NO_SPREAD = (1e-4, 0.0, 0.0, 0.0, 1e-4, 0.0, 0.0, 0.0, 1e-4)


def scan(step: int, *, x_m: float = 0.0, digest: str = "map", **more: Any) -> Scan:
    usual = Scan(
        sender="bridge",
        step=step,
        stamp_ns=step * 1_000_000_000,
        odom_from_robot=(x_m, 0.0, 0.0),
        robot_from_laser=(0.0, 0.0, 0.0),
        angle_min_rad=0.0,
        angle_step_rad=0.1,
        range_max_m=10.0,
        ranges=ArrayBlob.of(np.ones(3), "float32"),
        map_digest=digest,
    )
    return replace(usual, **more)


def particles(
    poses: Any, log_weights: Any = 0.0, *, step: int = 0, odom: PoseTuple = (0.0, 0.0, 0.0)
) -> Particles:
    """Particles at (N, 3) poses; of equal weights unless (N,) logarithms of them are given."""
    return Particles(
        step=step,
        odom_from_robot=odom,
        map_from_robot=ArrayBlob.of(poses, "float64"),
        log_weights=ArrayBlob.of(np.broadcast_to(log_weights, len(poses)), "float64"),
    )


def cloud_at(mean: PoseTuple, step: int) -> Particles:
    return particles([mean, mean], step=step)


def place(share: float, mean: PoseTuple, step: int) -> Place:
    return Place(share=share, pose=mean, covariance=NO_SPREAD, sample=cloud_at(mean, step))


def searched(
    job_id: str,
    step: int,
    places: dict[PoseTuple, float],
    *,
    epoch: int = 0,
    log_evidence: float = 0.0,
    left_out_gap: float = 12.0,
) -> SearchReport:
    return SearchReport(
        sender="w",
        job_id=job_id,
        epoch=epoch,
        step=step,
        log_evidence=log_evidence,
        particles=100,
        left_out_gap=left_out_gap,
        places=found_places([(share, mean) for mean, share in places.items()]),
    )


def found_places(found: Sequence[tuple[float, PoseTuple]], count: int = 2) -> FoundPlaces:
    return FoundPlaces.of(
        (0.0, 0.0, 0.0),
        [share for share, _ in found],
        [mean for _, mean in found],
        [NO_SPREAD for _ in found],
        [np.tile(mean, (count, 1)) for _, mean in found],
    )


def pool_of(*found: tuple[float, PoseTuple], step: int, left_out_gap: float = 12.0) -> Pool:
    """The places of one shard, without merging near ones."""
    share, mean = np.array([share for share, _ in found]), np.array([mean for _, mean in found])
    count = len(found)
    views = Views(
        odom_from_robot=(0.0, 0.0, 0.0),
        share=share,
        mean=mean,
        covariance=np.tile(NO_SPREAD, (count, 1)),
        begin=np.arange(count),
        count=np.ones(count, np.int64),
        particles=mean.astype(np.float32),
    )
    rows = tuple((row,) for row in range(count))
    return Pool(step, tuple(share.tolist()), rows, views, left_out_gap)


def tracked(
    job_id: str,
    step: int,
    likelihood: float,
    mean: PoseTuple,
    *,
    epoch: int = 0,
    snapshot: Particles | None = None,
    fits: Sequence[float] = (),
) -> TrackReport:
    """`fits`: of each beam, from 0 to 1; -1: it went through a wall."""
    return TrackReport(
        sender="w",
        job_id=job_id,
        epoch=epoch,
        step=step,
        log_weight_sum=math.log(likelihood * 100),
        particles=100,
        effective_sample_size=50.0,
        pose=mean,
        covariance=NO_SPREAD,
        snapshot=snapshot,
        fits=bytes(1 if fit < 0.0 else round(127 * fit) << 1 for fit in fits),
    )


def elsewhere(
    step: int, log_likelihood: float, *, epoch: int = 0, ends: Sequence[tuple[float, float]] = ()
) -> ElsewhereReport:
    """`ends` of the beams in the robot's frame."""
    return ElsewhereReport(
        sender="w",
        job_id="e0",
        epoch=epoch,
        step=step,
        log_likelihood=log_likelihood,
        seen=ArrayBlob.of(np.reshape(ends, (-1, 2)), "float64"),
    )
