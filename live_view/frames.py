"""Messages as the page reads them: plain objects with short names, rounded for the screen.

The page's `app.js` is the only reader and is served by the same process, so these have no versions.
"""

from collections.abc import Iterable, Mapping
from functools import lru_cache
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from protocol.answers import Belief, Hypothesis, PoseAnswer, Status
from protocol.job_events import NumberedEvent, event_text
from protocol.message import PoseTuple
from protocol.steps import LaserBeams, MapMessage, Scan

Frame: TypeAlias = dict[str, Any]

ROW_PLACES = 16
"""Of a step that is past, the most probable places that are plotted, and whose way is drawn."""
SIMULATOR = "robot_simulator"
"""As its process names itself in its health: it alone can be lifted and driven."""
MAX_BEAMS = 360
"""Of a scan on the page; of more, every second, third and so on is drawn."""


def map_frame(message: MapMessage) -> Frame:
    """Where the map lies and how large it is; the page fetches its cells by the digest."""
    return {
        "digest": message.digest,
        "rows": message.rows,
        "cols": message.cols,
        "cell_m": message.cell_m,
        "origin": message.map_from_grid,
    }


def step_frame(
    belief: Belief, slots: Mapping[int, int], scan: Scan | None, truth: PoseTuple | None
) -> Frame:
    """All that is drawn after one step."""
    return {
        "step": belief.step,
        "stamp_s": belief.stamp_ns / 1e9,
        "last": belief.last,
        "odom": belief.odom_from_robot,
        "state": belief.state,
        "searching": belief.searching,
        "search_progress": belief.search_progress,
        "missing": belief.missing,
        "places": [_place(place, slots[place.cluster]) for place in belief.hypotheses],
        "elsewhere": elsewhere_probability(belief),
        "off_map": belief.off_map_probability,
        "scan": [] if scan is None else scan_points_cm(scan),
        "laser": None if scan is None else [round(100.0 * m) for m in scan.robot_from_laser[:2]],
        "truth": truth,
    }


def elsewhere_probability(message: Belief | PoseAnswer) -> float | None:
    """That the robot is at none of the places; None: this version's messages do not say."""
    told: float | None = getattr(message, "elsewhere_probability", None)
    return told


def _place(place: Hypothesis, slot: int) -> Frame:
    xx, xy, _, _, yy, _, _, _, heading = place.covariance
    return {
        "cluster": place.cluster,
        "slot": slot,
        "p": place.probability,
        "pose": place.mean,
        "cov": (xx, xy, yy, heading),
        "age": place.age_steps,
    }


def history_row(frame: Frame) -> list[Any]:
    """What the way and the plot need of a step: step, places as (cluster, slot, p, x, y), truth."""
    places = [
        (p["cluster"], p["slot"], round(p["p"], 4), round(p["pose"][0], 2), round(p["pose"][1], 2))
        for p in frame["places"][:ROW_PLACES]
    ]
    return [frame["step"], places, frame["truth"]]


def scan_points_cm(scan: Scan) -> list[int]:
    """End points of the beams that returned, in the robot's frame [cm]: x, y, x, y, ..."""
    cm = _points_cm(scan)
    for other in scan.others:
        cm += _points_cm(other)
    return cm


def _points_cm(scan: Scan | LaserBeams) -> list[int]:
    beams = scan.ranges.array().ravel()
    every = -(-len(beams) // MAX_BEAMS) or 1
    ranges = beams[::every]
    x, y, heading = scan.robot_from_laser
    first, apart = scan.angle_min_rad + heading, every * scan.angle_step_rad
    returned = (ranges > 0.0) & (ranges < scan.range_max_m)  # which a NaN is not
    points = _directions_cm(len(ranges), first, apart)[returned] * ranges[returned, None]
    points += (100.0 * x, 100.0 * y)
    cm: list[int] = np.rint(points).astype(int).ravel().tolist()
    return cm


@lru_cache(maxsize=4)
def _directions_cm(count: int, first_rad: float, apart_rad: float) -> NDArray[np.float64]:
    """Where beams of a metre end: (count, 2); the same for all scans of a laser."""
    angles = first_rad + apart_rad * np.arange(count)
    return 100.0 * np.column_stack([np.cos(angles), np.sin(angles)])


def pose_frame(answer: PoseAnswer) -> Frame:
    """Where the robot is now."""
    frame: Frame = {
        "state": answer.state,
        "freshness": answer.freshness,
        "age_s": answer.age_s,
        "scan_age_s": answer.scan_age_s,
        "step": answer.step,
        "p": answer.probability,
        "pose": answer.map_from_robot,
        "workers": answer.workers,
        "elsewhere": elsewhere_probability(answer),
        "off_map": answer.off_map_probability,
    }
    if answer.covariance is not None:
        xx, _, _, _, yy, _, _, _, heading = answer.covariance
        frame["sigma"] = [float(np.sqrt(max(value, 0.0))) for value in (xx, yy, heading)]
    return frame


def status_frame(status: Status) -> Frame:
    """How the system is."""
    return {
        "version": status.version,
        "state": status.state,
        "freshness": status.freshness,
        "age_s": status.age_s,
        "scan_age_s": status.scan_age_s,
        "step": status.step,
        "applied": status.steps_applied,
        "lost": status.steps_lost,
        "reports_missing": status.reports_missing,
        "searching": status.searching,
        "search_progress": status.search_progress,
        "uptime_s": status.uptime_s,
        "workers": [
            {"name": name, "jobs": jobs, **_rates(name, status)}
            for name, jobs in status.workers.items()
        ],
        "simulated": any(health.sender == SIMULATOR for health in status.processes),
        "dropped": {cause: count for cause, count in status.counters.items() if count},
    }


def _rates(name: str, status: Status) -> Frame:
    for health in status.processes:
        if health.sender == name:
            rates = {what: round(rate, 1) for what, rate in health.rates_per_s.items()}
            return {"rates": rates, "mb": round(health.memory_bytes / 1e6)}
    return {}


def events_frame(events: Iterable[NumberedEvent]) -> list[Frame]:
    """What began and ended, and why, oldest first."""
    return [
        {
            "number": numbered.number,
            "step": numbered.step,
            "job": numbered.event.job_id,
            "cause": numbered.event.cause,
            "kind": type(numbered.event).__name__.lower(),
            "text": event_text(numbered.event),
        }
        for numbered in events
    ]
