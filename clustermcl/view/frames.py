"""Converts messages to frames: JSON objects for the page, with short names and rounded numbers.

Frames have no versions: only the page's scripts read them, which the same process serves.
"""

import zlib
from collections.abc import Iterable, Mapping
from functools import lru_cache
from typing import Any, TypeAlias

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from clustermcl.filter.observations.field import Field
from clustermcl.filter.observations.observed import Observed
from clustermcl.filter.observations.sighting import Sighting
from clustermcl.jobs.wire_observations import from_wire
from clustermcl.protocol.answers import Belief, Hypothesis
from clustermcl.protocol.changes import Changes
from clustermcl.protocol.errors import MalformedMessageError
from clustermcl.protocol.job_events import JobEvent, NumberedEvent, Remark, event_groups
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import LaserBeams, MapMessage, Scan
from clustermcl.protocol.why import Why, why_text
from clustermcl.protocol.work import Particles
from clustermcl.recordings.maps.grid_map import coarse

Frame: TypeAlias = dict[str, Any]

ROW_PLACES = 16
"""Limit for the places of a step in plot and trails; the most probable are kept."""
MAX_BEAMS = 360
"""Limit for the drawn beams of a laser; of more beams, only every second, third, ... is drawn."""
MAX_CHANGES = 20_000
"""Limit for the drawn cells that have changed."""
MAX_PARTICLES = 250
"""Limit for the drawn particles of a cluster; of more particles, a resampled set is drawn."""
MAX_SIDE = 4096
"""Limit for the rows and for the columns of the drawn map."""


def reduced(message: MapMessage) -> MapMessage:
    """Return the map with at most `MAX_SIDE` cells a side, see `coarse`.

    Raises:
        MalformedMessageError: the packed cells are damaged or too few.
    """
    every, size = -(-max(message.rows, message.cols) // MAX_SIDE), message.rows * message.cols
    if every <= 1:
        return message
    try:
        packed = zlib.decompressobj().decompress(message.zlib_cells, size)
        cells = coarse(np.frombuffer(packed, np.int8).reshape(message.rows, message.cols), every)
    except (zlib.error, ValueError) as error:
        raise MalformedMessageError(expected="map", problem=str(error)) from error
    (rows, cols), cell_m, packed = cells.shape, every * message.cell_m, zlib.compress(cells.data, 1)
    return replace(message, rows=rows, cols=cols, cell_m=cell_m, zlib_cells=packed)


def map_frame(message: MapMessage) -> Frame:
    """Return the map without its cells, which the page fetches separately."""
    return {
        "digest": message.digest,
        "rows": message.rows,
        "cols": message.cols,
        "cell_m": message.cell_m,
        "origin": message.map_from_grid,
        "floors": message.floors.floors,
        "landmarks": [(each.name, each.x, each.y) for each in message.landmarks],
    }


def step_frame(
    belief: Belief, slots: Mapping[int, int], scan: Scan | None, truth: PoseTuple | None
) -> Frame:
    """Return what the page draws of a step; its scan and its true pose may be unknown (None)."""
    return {
        "step": belief.step,
        "stamp_s": belief.stamp_ns / 1e9,
        "last": belief.last,
        "odom": belief.odom_from_robot,
        "state": belief.state,
        "searching": belief.searching,
        "search_progress": belief.search_progress,
        "places": place_frames(belief.hypotheses, slots, belief.why),
        "elsewhere": belief.elsewhere_probability,
        "off_map": belief.off_map_probability,
        **scan_frame(scan),
        "truth": truth,
    }


def scan_frame(scan: Scan | None) -> Frame:
    """Return the part of a step's frame that shows the scan.

    ``scan`` are the beams' end points (see `scan_points_cm`), ``laser`` is the position of the
    first laser [cm]; both are in the robot's frame. ``seen`` are the observations: a landmark's
    name and its position in the robot's frame [m], or no name and the robot's position in the map,
    which is that of the most likely cell of a field.
    """
    return {
        "scan": [] if scan is None else scan_points_cm(scan),
        "laser": None if scan is None else [round(100.0 * m) for m in scan.robot_from_laser[:2]],
        "seen": [] if scan is None else [_drawn_at(from_wire(s)) for s in scan.observations],
    }


def _drawn_at(seen: Observed) -> tuple[str, float, float]:
    x, y = seen.mean[:2].tolist()
    if isinstance(seen, Field):
        row, col = divmod(int(seen.log_likelihoods.argmax()), seen.log_likelihoods.shape[1])
        x, y = x + (col + 0.5) * seen.cell_m, y + (row + 0.5) * seen.cell_m
    return seen.landmark if isinstance(seen, Sighting) else "", x, y


def place_frames(places: Iterable[Hypothesis], slots: Mapping[int, int], why: Why) -> list[Frame]:
    """Return what is drawn of each place; the covariances are of x, x y, y and the heading."""
    return [
        {
            "cluster": place.cluster,
            "slot": slots[place.cluster],
            "p": place.probability,
            "pose": place.pose,
            "cov": [place.covariance[at] for at in (0, 1, 4, 8)],
            "age": place.age_steps,
            "why": why_text(why, index),
        }
        for index, place in enumerate(places)
    ]


def changes_frame(changes: Changes) -> Frame:
    """Return the changed cells, of many the last seen: x [m], y [m], kind, sights, first and last
    time [s] of each."""
    newest = np.argsort(changes.times_s.array()[:, 1])[-MAX_CHANGES:]
    centres, times_s = changes.centres_m().round(3), np.rint(changes.times_s.array())
    cells = np.column_stack([centres, changes.cells.array()[:, 1:3], times_s])
    return {
        "digest": changes.map_digest,
        "cell_m": changes.cell_m,
        "stamp_s": changes.stamp_ns / 1e9,
        "cells": cells[newest].tolist(),
    }


def history_row(frame: Frame) -> list[Any]:
    """Return a step's row for trails and plot: its number, its places, and the true pose.

    A place is (cluster, slot, probability, x [m], y [m]).
    """
    places = [
        (p["cluster"], p["slot"], round(p["p"], 4), round(p["pose"][0], 2), round(p["pose"][1], 2))
        for p in frame["places"][:ROW_PLACES]
    ]
    return [frame["step"], places, frame["truth"]]


def scan_points_cm(scan: Scan) -> list[int]:
    """Return the end points of all beams that returned: x, y, x, y, ..., robot's frame [cm]."""
    lasers: tuple[Scan | LaserBeams, ...] = (scan, *scan.others)
    return [cm for beams in lasers for cm in _points_cm(beams)]


def _points_cm(scan: Scan | LaserBeams) -> list[int]:
    beams = scan.ranges.array().ravel()
    every = -(-len(beams) // MAX_BEAMS) or 1
    ranges = beams[::every]
    x, y, heading = scan.robot_from_laser
    first, apart = scan.angle_min_rad + heading, every * scan.angle_step_rad
    returned = (ranges > 0.0) & (ranges < scan.range_max_m)  # false for NaN
    points = _directions_cm(len(ranges), first, apart)[returned] * ranges[returned, None]
    points += (100.0 * x, 100.0 * y)
    cm: list[int] = np.rint(points).astype(int).ravel().tolist()
    return cm


@lru_cache(maxsize=4)
def _directions_cm(count: int, first_rad: float, apart_rad: float) -> NDArray[np.float64]:
    """Return (count, 2) offsets of one metre along each beam, in the robot's axes [cm]."""
    angles = first_rad + apart_rad * np.arange(count)
    return 100.0 * np.column_stack([np.cos(angles), np.sin(angles)])


def events_frame(events: Iterable[NumberedEvent]) -> list[Frame]:
    return [
        {
            "step": first.step,
            "stamp_s": first.stamp_ns / 1e9,
            "cluster": _cluster_of(first.event) if len(others) == 0 else None,
            "kind": type(first.event).__name__.lower(),
            "text": text,
        }
        for (first, *others), text in event_groups(events)
    ]


def _cluster_of(event: JobEvent) -> int | None:
    if isinstance(event, Remark) or event.job_id[0] != "c":
        return None
    return int(event.job_id[1:])


def cloud_frame(cluster: int, particles: Particles) -> dict[str, Any]:
    """Return particles of a cluster, which the page moves with later odometry.

    ``points`` are x [cm], y [cm], heading [mrad], x, y, ...; ``odom`` is the odometry pose to which
    the points belong.
    """
    drawn = particles.resampled(min(particles.log_weights.shape[0], MAX_PARTICLES))
    points = np.rint(drawn * (100.0, 100.0, 1000.0)).astype(np.int64)
    return {
        "cluster": cluster,
        "step": particles.step,
        "odom": particles.odom_from_robot,
        "points": points.ravel().tolist(),
    }
