"""Collects the cells of a map that the building contradicts, while the robot is localized.

A cell changes once scans from several places contradict it without others that agree. Two
snapshots, of the time `TRUSTED_STEPS` and more ago, take back what a wrong robot has collected.
"""

import math
import zlib
from collections import deque
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from clustermcl.filter.arrays import Pose
from clustermcl.filter.kernels.compiled import to_cells
from clustermcl.filter.laser.seen_cells import (
    BEYOND_M,
    GROUND,
    NOT_WATCHED,
    WALL,
    WATCHED,
    codes_of,
    seen_cells,
)
from clustermcl.filter.poses import between, compose
from clustermcl.protocol.answers import Hypothesis, State
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.changes import (
    GONE,
    MOST_CELLS,
    MOVED,
    NEW,
    Changes,
    KeptChanges,
    unpacked_minutes,
)
from clustermcl.protocol.steps import LaserBeams, Scan
from clustermcl.recordings.maps.grid_map import GridMap, coarse

CELL_M = 0.1
"""Side of a coarse cell, as near as whole cells of the map allow [m]."""
REACH_M = 12.0
"""Beams are used up to this length: a heading's error moves the end of longer ones [m]."""
SIGHTS, MOST_SIGHTS = 1.5, 6.0
"""Scans that contradict a cell, less those that agree and what is forgotten, that change it; to
change it again it takes this many more, so that the edges of an obstacle are not moving. And how
many count at most."""
PLACE_M, LEAST_S = 0.5, 2.0
"""Least distance [m] and time [s] between the first and the last of these."""
FORGOTTEN_S = 7 * 86_400.0
"""Time after which 63 % of the sights of a cell are forgotten [s]."""
MOVING = 3
"""Changes after which a cell is moving, as at a door."""
TRUSTED_STEPS = 200
"""Localized steps after which what was collected is kept, if the robot was not found elsewhere."""
JUMP_M, JUMP_SHARE = 0.6, 0.2
JUMP_RAD, JUMP_RAD_PER_M = 0.35, 0.05
"""If another cluster is the best, and differs more from the last pose and odometry since, the robot
was wrong."""
MOST_SEEN, MOST_RECORDS = 2**16, 2**17
"""Limits for the cells that one laser sees, and for those that were contradicted: 8 MB."""
SIGMA_M, SIGMA_RAD = 0.5, 0.1
"""Poses that are less certain are not used."""
MOST_WAITING = 60
"""Scans before the robot is localized that are collected once it is."""
MOST_COUNT = 2**30
_TIME_S, _FAR_M = 2.0**34, 1e9
_FIELDS: dict[str, tuple[str, float, float]] = {
    "cell": ("<i4", 0, MOST_CELLS),
    "evidence": ("<f4", 0, MOST_SIGHTS),  # scans against what the cell is, less those that agree
    "first_s": ("<f8", -_TIME_S, _TIME_S),  # of these
    "x_m": ("<f8", -_FAR_M, _FAR_M),  # the laser at the first of these
    "y_m": ("<f8", -_FAR_M, _FAR_M),
    "last_s": ("<f8", -_TIME_S, _TIME_S),  # last sight of any kind
    "occupied": ("i1", 0, 1),  # what the cell is by what was seen
    "changes": ("<i4", 0, MOST_COUNT),
    "since_s": ("<f8", -_TIME_S, _TIME_S),  # first sight of its last change
    "sights": ("<i4", 0, MOST_COUNT),  # scans that agreed since
    "seen_s": ("<f8", -_TIME_S, _TIME_S),  # last of these
}
"""Type, least and largest value of each field of a record."""
RECORD = np.dtype([(name, kind) for name, (kind, *_) in _FIELDS.items()])
LAYOUT = str(RECORD.descr)
_RAW = np.dtype((np.void, RECORD.itemsize))
"""A record as bytes: numpy copies records field by field, 50 times as slowly."""


class ChangeCollector:
    """Collects changes of one map; its methods take events and keep the state."""

    def __init__(self, grid_map: GridMap) -> None:
        self.map = grid_map
        least = math.ceil(math.sqrt(grid_map.cells.size / MOST_CELLS))
        every = max(round(CELL_M / grid_map.cell_m), least)
        self.cell_m = every * grid_map.cell_m
        self._codes = codes_of(coarse(grid_map.cells, every))
        self.seen_min = np.zeros(self._codes.shape, np.int32)
        self._in_cells = to_cells(np.array(grid_map.map_from_grid), self.cell_m)
        self._out = np.empty((MOST_SEEN, 2), np.int32)
        self.records = np.empty(0, RECORD)
        """By cell."""
        self._trusted = self._recent = (self.records, 1)
        """Records and their minute, to go back to."""
        self._steps, self._way_m = 0, 0.0
        self.stamp_ns = 0
        self._last: tuple[int, Pose, Pose] | None = None
        """The cluster, the pose and odometry when the robot was last localized."""
        self._odometry: Pose | None = None
        self._waiting: deque[tuple[Scan, dict[int, Hypothesis]]] = deque(maxlen=MOST_WAITING)
        """Scans since the robot was last localized, and the places after each, by cluster."""

    def on_step(self, scan: Scan, state: State, places: Sequence[Hypothesis]) -> None:
        """Collect what a scan and those that wait show, if the robot is localized after it.

        The places are those of the belief after it, the most probable first. A scan that waits is
        collected from where the place that is now certain was then.
        """
        self.stamp_ns = scan.stamp_ns
        odometry = np.array(scan.odom_from_robot)
        if self._odometry is not None:
            self._way_m += math.dist(odometry[:2], self._odometry[:2])
        self._odometry = odometry
        if scan.map_digest != self.map.digest:
            return
        self._waiting.append((scan, {place.cluster: place for place in places}))
        if state != "localized":
            return
        best = places[0]
        pose = np.array(best.pose)
        if self._last is not None and best.cluster != self._last[0]:
            by_odometry = compose(self._last[1], between(self._last[2], odometry))
            x, y, turn = between(by_odometry, pose).tolist()
            is_far = math.hypot(x, y) > JUMP_M + JUMP_SHARE * self._way_m
            if is_far or abs(turn) > JUMP_RAD + JUMP_RAD_PER_M * self._way_m:
                self.withdraw()
        self._last, self._way_m = (best.cluster, pose, odometry), 0.0
        for earlier, places_then in self._waiting:
            if best.cluster in places_then:
                self._collect(places_then[best.cluster], earlier)
        self._waiting.clear()

    def withdraw(self) -> None:
        """Take back what was collected since the robot was last right.

        Cells that were seen since then were never seen: when they were seen before is not kept.
        """
        self._recent = self._trusted
        self.records, minute = self._trusted
        self.seen_min[self.seen_min >= minute] = 0
        self._watch()
        self._steps = 0

    def changes(self, sender: str) -> Changes:
        """Return what has changed, as a message."""
        all_of = self.records  # another thread may replace them
        moved = all_of["changes"] >= MOVING
        mapped = self._codes.reshape(-1)[all_of["cell"]] & WALL > 0
        kind = np.where(moved, MOVED, np.where(mapped, GONE, NEW))
        shown = moved | (all_of["occupied"] != mapped)
        kept, rows_cols = all_of[shown], self._codes.shape
        cells = [kept["cell"], kind[shown], kept["sights"], kept["changes"]]
        ground = self._codes & GROUND > 0
        lately = self.seen_min > max(minute_of(self.stamp_ns) - FORGOTTEN_S / 60.0, 0.0)
        return Changes(
            sender=sender,
            map_digest=self.map.digest,
            stamp_ns=self.stamp_ns,
            cell_m=self.cell_m,
            rows=rows_cols[0],
            cols=rows_cols[1],
            map_from_grid=self.map.map_from_grid,
            cells=ArrayBlob.of(np.column_stack(cells), "int32"),
            times_s=ArrayBlob.of(np.column_stack([kept["since_s"], kept["seen_s"]]), "float64"),
            seen_share=float((lately & ground).sum() / max(ground.sum(), 1)),
            zlib_seen_min=zlib.compress(self.seen_min.data, level=1),
        )

    @property
    def kept(self) -> KeptChanges:
        """All that was collected, for `restore`."""
        return KeptChanges(
            sender="changes",
            map_digest=self.map.cells_digest,
            layout=LAYOUT,
            records=self.records.tobytes(),
            trusted=self._trusted[0].tobytes(),
            trusted_min=self._trusted[1],
            zlib_seen_min=zlib.compress(self.seen_min.data, level=1),
        )

    def restore(self, kept: KeptChanges) -> None:
        """Continue from what was kept, if it is of this version, and of a map with these cells.

        Raises:
            ValueError, MalformedMessageError: it is damaged.
        """
        if (kept.map_digest, kept.layout) != (self.map.cells_digest, LAYOUT):
            return
        seen_min = unpacked_minutes(kept.zlib_seen_min, self._codes.shape).copy()
        trusted, records = (_checked(r, seen_min.size) for r in (kept.trusted, kept.records))
        self._trusted = trusted, kept.trusted_min
        self._recent = records, max(int(seen_min.max()), 1)
        self.records, self.seen_min = records, seen_min
        self._watch()

    def _collect(self, seen_from: Hypothesis, scan: Scan) -> None:
        xx, _, _, _, yy, _, _, _, turn = seen_from.covariance
        if max(xx, yy) > SIGMA_M**2 or turn > SIGMA_RAD**2:
            return
        pose = np.array(seen_from.pose)
        stamp_s = scan.stamp_ns * 1e-9
        lasers: tuple[Scan | LaserBeams, ...] = (scan, *scan.others)
        for laser in lasers:
            place = compose(pose, np.array(laser.robot_from_laser))
            count = seen_cells(
                self._codes, self.seen_min, minute_of(scan.stamp_ns), self._in_cells, place,
                laser.ranges.array().astype(np.float64), float(laser.angle_min_rad),
                float(laser.angle_step_rad), float(laser.range_max_m),
                REACH_M / self.cell_m, BEYOND_M / self.cell_m, self._out,
            )  # fmt: skip
            self._update(self._out[:count], place, stamp_s)
        self._steps += 1
        if self._steps % TRUSTED_STEPS == 0:
            self._trusted = self._recent
            self._recent = self.records, minute_of(scan.stamp_ns)

    def _update(self, seen: NDArray[np.int32], place: Pose, stamp_s: float) -> None:
        """Weigh what one laser has seen of cells, each at most once."""
        if len(self.records) + len(seen) > MOST_RECORDS:
            self.records = self.records[self.records["changes"] > 0][: MOST_RECORDS - len(seen)]
            self._watch()
        seen = seen[np.argsort(seen[:, 0])]
        records = self._with(seen[:, 0], stamp_s)
        at = np.searchsorted(records["cell"], seen[:, 0])
        of = records.take(at)
        against = of["occupied"] != seen[:, 1]
        kept = np.exp(-np.maximum(stamp_s - of["last_s"], 0.0) / FORGOTTEN_S) * of["evidence"]
        is_first = against & (kept <= 0.0)
        for name, value in (("first_s", stamp_s), ("x_m", place[0]), ("y_m", place[1])):
            of[name][is_first] = value
        of["evidence"] = np.clip(kept + np.where(against, 1.0, -1.0), 0.0, MOST_SIGHTS)
        of["last_s"] = stamp_s
        of["sights"] = np.minimum(of["sights"] + ~against, MOST_COUNT)
        of["seen_s"][~against] = stamp_s
        turned = against & (stamp_s - of["first_s"] >= LEAST_S)
        turned &= np.hypot(of["x_m"] - place[0], of["y_m"] - place[1]) >= PLACE_M
        turned &= of["evidence"] >= SIGHTS * (1 + of["changes"].clip(max=2))
        one = of.compress(turned)
        one["occupied"] ^= 1
        one["changes"] = np.minimum(one["changes"] + 1, MOST_COUNT)
        one["since_s"], one["seen_s"] = one["first_s"], stamp_s
        one["sights"], one["evidence"] = one["evidence"], 0.0
        of[turned] = one
        records[at] = of
        idle = (records["evidence"] <= 0.0) & (records["changes"] == 0)
        self._codes.reshape(-1)[records["cell"][idle]] &= NOT_WATCHED
        self.records = records.compress(~idle)

    def _with(self, cells: NDArray[np.int32], stamp_s: float) -> NDArray[np.void]:
        """Return a copy of the records, with these cells."""
        records, codes = self.records, self._codes.reshape(-1)
        new = cells[(codes[cells] & WATCHED) == 0]
        made = np.zeros(len(new), RECORD)
        made["cell"], made["last_s"] = new, stamp_s
        made["occupied"] = codes[new] & WALL > 0
        at = np.searchsorted(records["cell"], new)
        codes[new] |= np.uint16(WATCHED)
        return np.insert(records.view(_RAW), at, made.view(_RAW)).view(RECORD)

    def _watch(self) -> None:
        """Watch the cells of the records, and no others."""
        self._codes &= NOT_WATCHED
        self._codes.reshape(-1)[self.records["cell"]] |= np.uint16(WATCHED)


def _checked(data: bytes, cells: int) -> NDArray[np.void]:
    """Return the records of a file; raises ValueError if they are impossible."""
    records = np.frombuffer(data[: MOST_RECORDS * RECORD.itemsize], RECORD)
    for name, (_, least, most) in _FIELDS.items():
        if not ((records[name] >= least) & (records[name] <= most)).all():
            raise ValueError(f"{name} of a cell is impossible")
    if (np.diff(records["cell"], append=cells) <= 0).any():
        raise ValueError("the cells are in no order, or outside the map")
    return records


def minute_of(stamp_ns: int) -> int:
    """Return a stamp as the number of its minute, from 1 on; 0 is never."""
    return 1 + min(max(stamp_ns // 60_000_000_000, 0), 2**31 - 2)
