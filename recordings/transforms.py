"""ROS's tree of frames: where one frame is in another, at any time of a recording."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from particle_filter.trajectory import MAX_EXTRAPOLATION_NS

_SAME = 1e-6
_MAX_NAMED = 12


@dataclass(frozen=True)
class Transform:
    """One link of the tree at one time.

    Args:
        stamp_ns: when.
        parent: frame.
        child: frame.
        translation: of the child in the parent: x, y, z [m].
        quaternion: its rotation: x, y, z, w.
        fixed: it holds for all times.
    """

    stamp_ns: int
    parent: str
    child: str
    translation: tuple[float, float, float]
    quaternion: tuple[float, float, float, float]
    fixed: bool


@dataclass(frozen=True)
class Placements:
    """Where a frame is in another at n times.

    Args:
        translations: (n, 3) [m].
        rotations: n of them.
        known: (n,) whether transforms of that time are there; a place that is not is a guess.
    """

    translations: NDArray[np.float64]
    rotations: Rotation
    known: NDArray[np.bool_]

    def of(self, inner: "Placements") -> "Placements":
        """Where a frame is in the outer frame, given where it is in this one."""
        translations = self.translations + self.rotations.apply(inner.translations)
        return Placements(translations, self.rotations * inner.rotations, self.known & inner.known)

    def inverse(self) -> "Placements":
        """Where the outer frame is in this one."""
        back = self.rotations.inv()
        return Placements(-back.apply(self.translations), back, self.known)


class TransformTree:
    """All frames of a recording.

    Between two transforms, a link is interpolated. A link that moves is known a quarter of a
    second before its first and after its last transform; one that does not move, always.

    Args:
        transforms: in the order of the recording.
    """

    def __init__(self, transforms: Iterable[Transform]) -> None:
        by_link: dict[tuple[str, str], list[Transform]] = {}
        for transform in transforms:
            by_link.setdefault((transform.child, transform.parent), []).append(transform)
        self._links = {names: _Link(found) for names, found in by_link.items()}
        self._parents: dict[str, list[str]] = {}
        for child, parent in by_link:
            self._parents.setdefault(child, []).append(parent)

    def __str__(self) -> str:
        links = sorted(f"{parent} -> {child}" for child, parent in self._links)
        more = ", ..." if len(links) > _MAX_NAMED else ""
        return (", ".join(links[:_MAX_NAMED]) + more) or "no transform"

    def knows(self, frame: str) -> bool:
        """Whether any transform names the frame."""
        return any(frame in names for names in self._links)

    def moves(self, child: str, parent: str) -> bool:
        """Whether a link changes."""
        return not self._links[child, parent].still

    def way_up(self, frame: str, to: str | None = None) -> list[str]:
        """The frame, its parent, its parent's parent and so on, to a frame or the top.

        Raises:
            ValueError: a frame has two parents, or is its own ancestor.
        """
        way = [frame]
        while way[-1] != to and (parents := self._parents.get(way[-1])):
            if len(parents) > 1:
                named = " and ".join(sorted(parents))
                raise ValueError(f"tf gives the frame {way[-1]!r} {len(parents)} parents: {named}")
            way.append(parents[0])
            if way.count(way[-1]) > 1:
                raise ValueError(f"tf loops: {' -> '.join(reversed(way))}")
        return way

    def placements(self, outer: str, inner: str, stamps_ns: NDArray[np.int64]) -> Placements:
        """Where `inner` is in `outer` at (n,) times.

        Raises:
            ValueError: nothing connects the two.
        """
        if outer == inner:
            count = len(stamps_ns)
            here = Rotation.identity(count)
            return Placements(np.zeros((count, 3)), here, np.ones(count, np.bool_))
        inner_way = self.way_up(inner, to=outer)
        outer_way = self.way_up(outer, to=inner)
        common = next((frame for frame in inner_way if frame in outer_way), None)
        if common is None:
            raise ValueError(f"no transform from {outer!r} to {inner!r}; tf holds {self}")
        of_outer = self._up(outer_way[: outer_way.index(common) + 1], stamps_ns)
        of_inner = self._up(inner_way[: inner_way.index(common) + 1], stamps_ns)
        if of_outer is None or of_inner is None:
            only = of_inner or (of_outer and of_outer.inverse())
            assert only is not None  # two frames that are not the same
            return only
        return of_outer.inverse().of(of_inner)

    def _up(self, way: Sequence[str], stamps_ns: NDArray[np.int64]) -> Placements | None:
        """Where the first frame of a way up is in the last; None: it is the last."""
        found: Placements | None = None
        for child, parent in pairwise(way):
            link = self._links[child, parent].at(stamps_ns)
            found = link.of(found) if found else link
        return found


class _Link:
    """One link at all times."""

    def __init__(self, transforms: Sequence[Transform]) -> None:
        if transforms[-1].fixed:
            transforms = transforms[-1:]
        stamps = np.array([one.stamp_ns for one in transforms], np.int64)
        # Of two with one stamp, the later counts.
        self._stamps, last = np.unique(stamps[::-1], return_index=True)
        kept = len(stamps) - 1 - last
        self._translations = np.array([one.translation for one in transforms])[kept]
        self._rotations = Rotation.from_quat(np.array([one.quaternion for one in transforms])[kept])
        turned = (self._rotations[0].inv() * self._rotations).magnitude()
        self.still = bool(
            np.all(np.abs(self._translations - self._translations[0]) < _SAME)
            and np.all(turned < _SAME)
        )

    def at(self, stamps_ns: NDArray[np.int64]) -> Placements:
        """Where the child is in the parent at (n,) times."""
        if self.still:
            first = np.zeros(len(stamps_ns), np.intp)
            known = np.ones(len(stamps_ns), np.bool_)
            return Placements(self._translations[first], self._rotations[first], known)
        begin, end = self._stamps[[0, -1]]
        known = (stamps_ns >= begin - MAX_EXTRAPOLATION_NS) & (
            stamps_ns <= end + MAX_EXTRAPOLATION_NS
        )
        times = (np.clip(stamps_ns, begin, end) - begin) / 1e9
        nodes = (self._stamps - begin) / 1e9
        translations = np.column_stack(
            [np.interp(times, nodes, column) for column in self._translations.T]
        )
        return Placements(translations, Slerp(nodes, self._rotations)(times), known)
