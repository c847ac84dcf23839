"""Messages with only what a test cares about."""

import math

import numpy as np

from protocol.arrays import ArrayBlob
from protocol.message import PoseTuple
from protocol.steps import Scan
from protocol.work import Particles, Place, SearchReport, TrackReport

NO_SPREAD = (0.01, 0.0, 0.0, 0.0, 0.01, 0.0, 0.0, 0.0, 0.01)


def scan(
    step: int,
    *,
    x_m: float = 0.0,
    paced: bool = False,
    digest: str = "map",
    live: bool = False,
) -> Scan:
    return Scan(
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
        paced=paced,
        live=live,
    )


def cloud_at(mean: PoseTuple, step: int) -> Particles:
    return Particles(
        step=step,
        odom_from_robot=(0.0, 0.0, 0.0),
        map_from_robot=ArrayBlob.of(np.array([mean, mean]), "float64"),
        log_weights=ArrayBlob.of(np.zeros(2), "float64"),
    )


def place(share: float, mean: PoseTuple, step: int) -> Place:
    return Place(share=share, mean=mean, covariance=NO_SPREAD, sample=cloud_at(mean, step))


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
        log_likelihood_per_beam=-1.0,
        places=tuple(place(share, mean, step) for mean, share in places.items()),
    )


def tracked(
    job_id: str,
    step: int,
    likelihood: float,
    mean: PoseTuple,
    *,
    epoch: int = 0,
    fit: float = -1.0,
    snapshot: Particles | None = None,
) -> TrackReport:
    return TrackReport(
        sender="w",
        job_id=job_id,
        epoch=epoch,
        step=step,
        log_weight_sum=math.log(likelihood * 100),
        particles=100,
        log_likelihood_per_beam=fit,
        effective_sample_size=50.0,
        mean=mean,
        covariance=NO_SPREAD,
        snapshot=snapshot,
    )
