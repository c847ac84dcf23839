"""The tree of ROS's frames, from `/tf` and `/tf_static`.

A lookup interpolates, but does not extrapolate; its error names the link that lacks a transform.
"""

from bisect import bisect_left
from enum import Enum, auto
from operator import itemgetter

from clustermcl.recordings.rigid import IDENTITY, Rigid

CACHE_NS = 10_000_000_000
"""Age at which transforms of a moving link are dropped, as in tf2 [ns]."""
LATE_NS = 1_000_000_000
"""Largest age of a new transform, compared with the newest of its link [ns]."""
RESTART_AFTER = 20
"""After this number of consecutive late transforms of a link, the clock was set back."""
_MAX_NAMED = 8
_MOST_FRAMES = 1000

_stamp = itemgetter(0)


class Kept(Enum):
    """Result of adding a transform."""

    YES = auto()
    NO = auto()
    """The transform is late, or there are too many frames."""
    CLOCK_SET_BACK = auto()
    """The transform is kept after many late ones; all moving links were dropped before."""


class TransformMissingError(ValueError):
    """Two frames are not connected, or not at the requested time.

    Attributes:
        cause: the problem without names and numbers, by which it is counted.
        may_come: whether a later message may provide the transform.
    """

    def __init__(self, problem: str, *, cause: str, may_come: bool = True) -> None:
        self.cause, self.may_come = cause, may_come
        super().__init__(problem)


class TransformTree:
    """All links between frames.

    Args:
        cache_ns: age at which transforms of a moving link are dropped; late ones are refused.
            None: for a recording, keep all, in any order.
        slack_ns: time for which the first transform of a link holds before it, and the last
            after it.
    """

    def __init__(self, cache_ns: int | None = CACHE_NS, slack_ns: int = 0) -> None:
        self._cache_ns, self._slack_ns = cache_ns, slack_ns
        self._links: dict[str, _Link] = {}

    def add(
        self, stamp_ns: int, parent: str, child: str, parent_from_child: Rigid, *, fixed: bool
    ) -> Kept:
        """Add a transform; a child that has another parent is moved to the new one."""
        link = self._links.get(child)
        if link is None or link.parent != parent or link.fixed != fixed:
            if link is None and len(self._links) >= _MOST_FRAMES:
                return Kept.NO
            link = _Link(parent, child, fixed=fixed, cache_ns=self._cache_ns)
            self._links[child] = link
        if link.add(stamp_ns, parent_from_child):
            return Kept.YES
        if link.late_in_a_row < RESTART_AFTER:
            return Kept.NO
        self.forget_moving()
        self.add(stamp_ns, parent, child, parent_from_child, fixed=fixed)
        return Kept.CLOCK_SET_BACK

    def forget_moving(self) -> None:
        self._links = {child: link for child, link in self._links.items() if link.fixed}

    def keep_newest(self) -> None:
        for link in self._links.values():
            link.keep_newest()

    def knows(self, frame: str) -> bool:
        return frame in self._links or any(one.parent == frame for one in self._links.values())

    def moves(self, child: str) -> bool:
        return not self._links[child].fixed

    def newest_ns(self, outer: str, inner: str) -> int | None:
        """Return the newest time [ns] at which all moving links between two frames are known.

        None: the frames are not connected, or no link between them moves.
        """
        try:
            ways = self._ways(outer, inner)
        except TransformMissingError:
            return None
        links = (self._links[frame] for way in ways for frame in way)
        return min((link.newest_ns for link in links if not link.fixed), default=None)

    def lookup(self, outer: str, inner: str, stamp_ns: int) -> Rigid:
        """Return the pose of frame `inner` in frame `outer` at a time.

        Raises:
            TransformMissingError: the frames are not connected, or not at that time.
        """
        outer_way, inner_way = self._ways(outer, inner)
        of_inner, of_outer = self._up(inner_way, stamp_ns), self._up(outer_way, stamp_ns)
        return of_outer.inverse().of(of_inner) if outer_way else of_inner

    def _ways(self, outer: str, inner: str) -> tuple[list[str], list[str]]:
        """Return the frames from `outer`, and those from `inner`, below the common ancestor."""
        inner_way, outer_way = self.way_up(inner, outer), self.way_up(outer, inner)
        common = next((frame for frame in inner_way if frame in outer_way), None)
        if common is None:
            problem = f"no transform from {outer!r} to {inner!r}; tf has {self}"
            raise TransformMissingError(problem, cause="frames not connected")
        return outer_way[: outer_way.index(common)], inner_way[: inner_way.index(common)]

    def __str__(self) -> str:
        links = [f"{link.parent} -> {child}" for child, link in sorted(self._links.items())]
        more = ", ..." if len(links) > _MAX_NAMED else ""
        return (", ".join(links[:_MAX_NAMED]) + more) or "no transform"

    def way_up(self, frame: str, to: str | None = None) -> list[str]:
        """Return the frame and its ancestors, up to the frame `to` or the root.

        Raises:
            TransformMissingError: a frame is its own ancestor.
        """
        way = [frame]
        while way[-1] != to and (link := self._links.get(way[-1])):
            if link.parent in way:
                loop = " -> ".join([link.parent, *reversed(way)])
                raise TransformMissingError(f"tf loops: {loop}", cause="tf loops")
            way.append(link.parent)
        return way

    def _up(self, way: list[str], stamp_ns: int) -> Rigid:
        """Return the pose of a way's first frame, relative to the parent of its last frame."""
        found = IDENTITY
        for child in way:
            found = self._links[child].at(stamp_ns, self._slack_ns).of(found)
        return found


class _Link:
    def __init__(self, parent: str, child: str, *, fixed: bool, cache_ns: int | None) -> None:
        self.parent, self.fixed, self.late_in_a_row = parent, fixed, 0
        self._name, self._cache_ns = f"tf from {parent!r} to {child!r}", cache_ns
        self._known: list[tuple[int, Rigid]] = []

    @property
    def newest_ns(self) -> int:
        return self._known[-1][0]

    def add(self, stamp_ns: int, parent_from_child: Rigid) -> bool:
        known = self._known
        if self.fixed:
            known[:] = [(stamp_ns, parent_from_child)]
            return True
        if self._cache_ns is not None and known and stamp_ns < known[-1][0] - LATE_NS:
            self.late_in_a_row += 1
            return False
        self.late_in_a_row = 0
        place = bisect_left(known, stamp_ns, key=_stamp)
        replaced = place < len(known) and known[place][0] == stamp_ns
        known[place : place + replaced] = [(stamp_ns, parent_from_child)]
        if self._cache_ns is not None and known[0][0] < known[-1][0] - self._cache_ns:
            del known[: bisect_left(known, known[-1][0] - self._cache_ns, key=_stamp)]
        return True

    def keep_newest(self) -> None:
        del self._known[:-1]

    def at(self, stamp_ns: int, slack_ns: int) -> Rigid:
        known = self._known
        if self.fixed:
            return known[0][1]
        nearest_ns = min(max(stamp_ns, known[0][0]), known[-1][0])
        if abs(stamp_ns - nearest_ns) <= slack_ns:
            stamp_ns = nearest_ns
        after = bisect_left(known, stamp_ns, key=_stamp)
        if after == len(known):
            late_s = (stamp_ns - known[-1][0]) / 1e9
            problem = f"{self._name} ends {late_s:.3f} s before that time"
            raise TransformMissingError(problem, cause="transform does not arrive")
        end_ns, end = known[after]
        if end_ns == stamp_ns:
            return end
        if after == 0:
            early_s = (end_ns - stamp_ns) / 1e9
            problem = f"{self._name} begins {early_s:.3f} s after that time"
            cause = "before the first transform"
            raise TransformMissingError(problem, cause=cause, may_come=False)
        start_ns, start = known[after - 1]
        return start.towards(end, (stamp_ns - start_ns) / (end_ns - start_ns))
