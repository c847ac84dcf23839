"""Memory of the pieces of wall that the robot has seen, so that each of them counts once.

Where the map is wrong, every scan of that piece repeats the error. So evidence belongs to pieces: a
piece is a block of a frame that all places share, and only what is new of a piece counts. What
later beams pass was no wall. The frame is odometry, corrected by the most probable place: else what
was seen before would be new pieces as odometry drifts, and turning would make a robot sure.
"""

from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta
from msgspec.structs import replace
from numpy.typing import NDArray

from clustermcl.filter.arrays import Points, Pose
from clustermcl.filter.poses import compose

PIECE_M = 0.5
"""Side of a piece [m]."""
DOUBTFUL = 2.0
"""Number of beams that must end in a piece before it has counted half."""
BEFORE_M = 0.75
"""Beams pass the pieces up to this distance before their ends [m]."""
FARTHEST_M = 60.0
"""They pass no pieces farther away than this, so that memory is bounded [m]."""
MAX_PIECES = 2_000
"""Largest number of pieces; those far from the robot are forgotten first."""
_ROW = np.dtype([("x", "<i4"), ("y", "<i4"), ("ended", "<f4"), ("passed", "<f4")])
_FAR_M = 2e8
"""Ends and robots farther away than this have no piece [m]: their blocks must fit into int32."""
_Coordinate = Annotated[float, Meta(ge=-_FAR_M, le=_FAR_M)]


class Pieces(msgspec.Struct, frozen=True):
    """The pieces in any order."""

    rows: bytes = b""
    """(J, 4) block's column and row as int32; numbers of beams that ended in it and passed it as
    float32; little-endian."""
    robot: tuple[_Coordinate, _Coordinate, float] = (0.0, 0.0, 0.0)
    """Pose of the robot in the frame of the pieces."""

    @property
    def problem(self) -> str | None:
        """Why `rows` is invalid; None: it is valid."""
        count, rest = divmod(len(self.rows), _ROW.itemsize)
        if rest or count > MAX_PIECES:
            return f"{len(self.rows)} bytes of pieces"
        rows = np.frombuffer(self.rows, _ROW)
        possible = (rows["ended"] >= 0.0) & (rows["passed"] >= 0.0)  # false for NaN
        return None if possible.all() else "pieces out of range"

    def moved(self, before_from_after: Pose) -> "Pieces":
        """Return the memory of a robot that has moved by this (3,) pose.

        Where it errs, walls that were seen before are new pieces.
        """
        x, y, heading = compose(np.array(self.robot), before_from_after).tolist()
        return replace(self, robot=(x, y, heading)) if max(abs(x), abs(y)) < _FAR_M else Pieces()

    def after(self, ends_in_robot: Points) -> "tuple[NDArray[np.float64], float, Pieces]":
        """Return what is new of a scan, and the memory with it.

        A piece counts n / (n + passes + 2) after n beams. The difference that this scan makes is
        shared by its beams that end there.

        Args:
            ends_in_robot: (B, 2) ends of the beams [m].

        Returns:
            (B,) weights of the beams, 0 to 1; their sum, as a share of that with an empty memory;
            and the new memory.
        """
        count = len(ends_in_robot)
        if not count or not (np.abs(ends_in_robot) < _FAR_M).all():
            return np.zeros(count), 0.0, self
        robot = np.array(self.robot)
        ends = compose(robot, np.column_stack((ends_in_robot, np.zeros(count))))[:, :2]
        rows = np.frombuffer(self.rows, _ROW)
        known, at = _keys(np.stack((rows["x"], rows["y"]), axis=-1)), _keys(_blocks(ends))
        keys, inverse = np.unique(np.concatenate((known, at)), return_inverse=True)
        ended, passed = np.zeros((2, len(keys)))
        ended[inverse[: len(rows)]] = rows["ended"]
        passed[inverse[: len(rows)]] = rows["passed"]
        of_beam = inverse[len(rows) :]
        here = np.bincount(of_beam, minlength=len(keys))
        more = ended + here
        new = more / (more + passed + DOUBTFUL) - ended / (ended + passed + DOUBTFUL)
        weights = (new / np.maximum(here, 1))[of_beam]
        share = float(new.sum() / (here / (here + DOUBTFUL)).sum())
        crossed = _keys(_crossed(robot[:2], ends))
        place = np.searchsorted(keys, crossed)
        place[place == len(keys)] = 0
        np.add.at(passed, place[keys[place] == crossed], 1.0)
        x, y = np.divmod(keys, 2**32)
        made = np.empty(len(keys), _ROW)
        made["x"], made["y"], made["ended"], made["passed"] = x, y - 2**31, more, passed
        if len(made) > MAX_PIECES:
            column, row = robot[:2] / PIECE_M
            away = np.hypot(made["x"] - column, made["y"] - row)
            made = made[np.sort(np.argsort(away, kind="stable")[:MAX_PIECES])]
        return weights, share, Pieces(made.tobytes(), self.robot)


def _blocks(points: Points) -> NDArray[np.int64]:
    return np.floor(points / PIECE_M).astype(np.int64)


def _keys(blocks: NDArray[np.integer]) -> NDArray[np.int64]:
    """Return (N,) one number for each of (N, 2) blocks."""
    return np.asarray(blocks[:, 0].astype(np.int64) * 2**32 + blocks[:, 1] + 2**31)


def _crossed(start: Points, ends: Points) -> NDArray[np.int64]:
    """Return (N, 2) blocks that beams pass, each block once for a beam."""
    way = ends - start
    length = np.hypot(way[:, 0], way[:, 1])
    count = (np.clip(length - BEFORE_M, 0.0, FARTHEST_M) / PIECE_M).astype(np.int64)
    beam = np.repeat(np.arange(len(ends)), count)
    step = np.arange(len(beam)) - np.repeat(np.cumsum(count) - count, count) + 1
    blocks = _blocks(start + way[beam] * (step * PIECE_M / length[beam])[:, None])
    return np.unique(np.column_stack((beam, blocks)), axis=0)[:, 1:]
