"""Writes map, scans, places and probabilities to a file for Rerun's viewer, the extra `rerun`."""

import math
from pathlib import Path
from typing import Any

import numpy as np

from clustermcl.filter.arrays import OCCUPIED
from clustermcl.filter.poses import compose
from clustermcl.protocol.answers import Belief, Hypothesis
from clustermcl.protocol.floors import ONE_MAP
from clustermcl.protocol.message import ellipse_axes
from clustermcl.protocol.steps import MapMessage, Scan
from clustermcl.recordings.maps.map_message import from_message
from clustermcl.view.frames import scan_points_cm
from clustermcl.view.plots import PALETTE, NoExtraError, percent

_SIGMAS, _PLOTTED, _NOSE_M = 2.0, 16, 0.5
_MAP_RGB, _SCAN_RGB = (42, 50, 59), (192, 38, 45)
_AROUND = np.linspace(0.0, 2.0 * math.pi, 49)


class RerunLog:
    """A recording for Rerun's viewer; takes what `Picture` takes.

    Raises:
        NoExtraError: the extra ``rerun`` is not installed.
    """

    def __init__(self, file: Path) -> None:
        try:
            import rerun  # noqa: PLC0415 - an extra
        except ImportError as error:
            raise NoExtraError("rerun", error) from error
        self._rerun: Any = rerun
        self._log: Any = rerun.RecordingStream("clustermcl")
        self._log.save(file)
        self._scan: Scan | None = None
        self._floors = ONE_MAP

    def on_map(self, message: MapMessage) -> None:
        """Show the occupied cells, from the beginning on."""
        self._floors, grid = message.floors, from_message(message)
        rows, cols = np.nonzero(grid.cells == OCCUPIED)
        centres = np.column_stack([cols + 0.5, rows + 0.5, 0.0 * rows]) * grid.cell_m
        points = compose(np.array(grid.map_from_grid), centres)
        self._points("map", points, 0.5 * grid.cell_m, _MAP_RGB, static=True)

    def on_scan(self, scan: Scan) -> None:
        """Keep the scan for its belief."""
        self._scan = scan

    def on_belief(self, belief: Belief) -> None:
        """Show the places of a step, its scan as from the best one, and all probabilities."""
        rerun, log, places = self._rerun, self._log, self._floors.drawn(belief).hypotheses
        log.set_time("step", sequence=belief.step)
        log.set_time("robot", timestamp=np.datetime64(belief.stamp_ns, "ns"))
        poses = np.array([place.pose for place in places]).reshape(-1, 3)
        hexes = [int(f"{PALETTE[place.cluster % len(PALETTE)][1:]}ff", 16) for place in places]
        noses = np.column_stack([np.cos(poses[:, 2]), np.sin(poses[:, 2]), 0.0 * poses[:, 2]])
        labels = [percent(place.probability) for place in places]
        log.log("places", rerun.Arrows3D(origins=_flat(poses), vectors=_NOSE_M * noses,
                                         colors=hexes, labels=labels))  # fmt: skip
        log.log("places/spread", rerun.LineStrips3D([*map(_ellipse, places)], colors=hexes))
        if places and self._scan is not None and self._scan.step == belief.step:
            ends = np.reshape(scan_points_cm(self._scan), (-1, 2)) / 100.0
            ends = compose(poses[0], np.column_stack([ends, np.zeros(len(ends))]))
            self._points("scan", ends, 0.03, _SCAN_RGB)
        for place in places[:_PLOTTED]:
            log.log(f"probability/{place.cluster}", rerun.Scalars(place.probability))
        log.log("probability/elsewhere", rerun.Scalars(belief.elsewhere_probability))
        log.log("state", rerun.TextLog(belief.state))

    def on_link(self, link: str) -> None:
        if link == "finished":
            self._log.disconnect()  # writes the rest

    def ignore(self, *_: object) -> None:
        """Rerun shows no pose between steps, and no event."""

    on_pose = on_events = ignore

    def _points(self, name: str, poses: Any, radius: float, colour: Any, **how: Any) -> None:
        points = self._rerun.Points3D(_flat(poses), radii=radius, colors=colour)
        self._log.log(name, points, **how)


def _flat(poses: Any) -> Any:
    """Return (N, 3) positions on the ground for (N, 3) poses."""
    return poses * (1.0, 1.0, 0.0)


def _ellipse(place: Hypothesis) -> Any:
    """Return (49, 3) points around a place, two standard deviations from it [m]."""
    c, (x, y, _) = place.covariance, place.pose
    long_m, short_m, along = ellipse_axes(c[0], c[1], c[4])
    circle = np.column_stack([long_m * np.cos(_AROUND), short_m * np.sin(_AROUND), _AROUND])
    return _flat(compose(np.array((x, y, along)), _SIGMAS * circle))
