"""A cluster's particles, thinned out for the screen."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from protocol.work import Particles, TrackReport

MAX_PARTICLES = 250
"""Of a cluster on the page: drawn from its own by weight, so a dense place stays dense."""
MARK = b"track_report/"
"""Near the beginning of a report that may have particles; those of searches are large."""
MIN_BYTES = 3000
"""A report without particles is smaller, one of a hundred particles is not."""


def may_have_particles(payload: bytes) -> bool:
    """Whether a report, still undecoded, is worth decoding: nine of ten have no particles."""
    return len(payload) >= MIN_BYTES and MARK in payload[:100]


def cluster_of(report: TrackReport) -> int | None:
    """The number of the cluster that a job tracks; None: that is no name of such a job."""
    number = report.job_id.removeprefix("c")
    return int(number) if number.isascii() and number.isdigit() and len(number) < 16 else None


def cloud_frame(cluster: int, particles: Particles) -> dict[str, Any]:
    """The particles as the page carries them forward.

    Its ``points`` are x [cm], y [cm], heading [mrad], x, y, ...; ``odom`` is where odometry stood.
    """
    chosen = _drawn(particles.log_weights.array(), MAX_PARTICLES)
    points = np.rint(particles.map_from_robot.array()[chosen] * (100.0, 100.0, 1000.0)).astype(
        np.int64
    )
    return {
        "cluster": cluster,
        "step": particles.step,
        "odom": particles.odom_from_robot,
        "points": points.ravel().tolist(),
    }


def _drawn(log_weights: NDArray[np.float64], most: int) -> NDArray[np.int64]:
    """Indices of at most so many particles, each as often as its weight says, without chance."""
    shares = np.cumsum(np.exp(log_weights - log_weights.max()))
    count = min(most, len(shares))
    drawn: NDArray[np.int64] = np.searchsorted(
        shares, (np.arange(count) + 0.5) / count * shares[-1]
    )
    return drawn
