"""The floors of a building, side by side in one grid, the atlas, in which the filter works.

Poses in messages are in the frame of their floor; inside they are in that of the atlas. They are
converted here. The axes of both frames are parallel, so covariances are the same.
"""

from __future__ import annotations  # `help` shows names of types, not their definitions

import math
from collections.abc import Iterable, Iterator
from typing import Annotated, TypeAlias

from msgspec import Meta
from msgspec.structs import replace

from clustermcl.protocol.answers import (
    MAX_FLOOR_CHARACTERS,
    MAX_FLOORS,
    Belief,
    Hypothesis,
    PoseAnswer,
)
from clustermcl.protocol.errors import printable
from clustermcl.protocol.message import Circle, Coordinate, Corners, Finite, Part, PoseTuple

MAX_LINKS = 256
FloorName: TypeAlias = Annotated[str, Meta(min_length=1, max_length=MAX_FLOOR_CHARACTERS)]
Position: TypeAlias = tuple[Coordinate, Coordinate]
"""x [m], y [m]."""


class Floor(Part, frozen=True):
    """One floor, and its part of the atlas."""

    name: FloorName
    shift: Position
    """Added to a position on the floor, it gives the position in the atlas [m]."""
    low: Position
    """Corner with the least x and y of the floor's part of the atlas [m]."""
    high: Position
    """The opposite corner."""
    height_m: Finite = 0.0

    def distance_m(self, x: float, y: float) -> float:
        """Return how far a point of the atlas is outside of the floor, along x or y [m]."""
        (left, low), (right, high) = self.low, self.high
        return max(left - x, x - right, low - y, y - high, 0.0)


class Link(Part, frozen=True):
    """A lift, a ramp or stairs: within the radius, a robot may change its floor."""

    name: FloorName
    at: Annotated[dict[FloorName, Position], Meta(min_length=2, max_length=MAX_FLOORS)]
    """Its position on each floor, in the frame of that floor."""
    radius_m: Annotated[float, Meta(gt=0.0, le=20.0)] = 1.5


class Floors(Part, frozen=True):
    """The floors of a building and their links; empty for a single map."""

    floors: Annotated[tuple[Floor, ...], Meta(max_length=MAX_FLOORS)] = ()
    links: Annotated[tuple[Link, ...], Meta(max_length=MAX_LINKS)] = ()

    def __bool__(self) -> bool:
        return bool(self.floors)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(floor.name for floor in self.floors)

    def floor(self, name: str) -> Floor:
        """Return a floor by its name; a `ValueError`: there is none."""
        if name in self.names:
            return self.floors[self.names.index(name)]
        wrong = f"there is no floor {printable(name)!r}" if name else "name a floor"
        raise ValueError(f"{wrong}; the floors are: {', '.join(self.names) or 'none'}")

    def on_floor(self, pose: PoseTuple) -> tuple[str, PoseTuple]:
        """Return the floor of a pose in the atlas, and the pose there; "" for a single map."""
        if not self.floors:
            return "", pose
        x, y, heading = pose
        floor = min(self.floors, key=lambda each: each.distance_m(x, y))
        return floor.name, (x - floor.shift[0], y - floor.shift[1], heading)

    def in_atlas(self, floor: str, pose: PoseTuple) -> PoseTuple:
        """Return a pose in the atlas, which for a single map is that map.

        Raises:
            ValueError: there is no such floor; a building needs one, a single map has none.
        """
        if not (self.floors or floor):
            return pose
        (right, up), (x, y, heading) = self.floor(floor).shift, pose
        return x + right, y + up, heading

    def area(self, floor: str, near: Circle | None) -> tuple[Circle | None, Corners | None]:
        """Return a circle in the atlas, if one is given, and the corners of the floor."""
        if not floor:
            return near, None
        here = self.floor(floor)
        circle = near and (near[0] + here.shift[0], near[1] + here.shift[1], near[2])
        return circle, (here.low, here.high)

    def rides(self, pose: PoseTuple) -> tuple[PoseTuple, ...]:
        """Return where a robot at a pose of the atlas is on the other floors of links in reach."""
        floor, (x, y, heading) = self.on_floor(pose)
        return tuple(
            self.in_atlas(name, (x - at[0] + there[0], y - at[1] + there[1], heading))
            for link in self._in_reach(floor, x, y)
            for at in (link.at[floor],)
            for name, there in link.at.items()
            if name != floor and name in self.names
        )

    def radius_m(self, pose: PoseTuple) -> float:
        """Return the radius of the link that a pose of the atlas is in reach of; 0: of none."""
        floor, (x, y, _) = self.on_floor(pose)
        return max((link.radius_m for link in self._in_reach(floor, x, y)), default=0.0)

    def _in_reach(self, floor: str, x: float, y: float) -> Iterator[Link]:
        """Yield the links that a position on a floor is in reach of."""
        for link in self.links:
            at = link.at.get(floor)
            if at is not None and math.dist(at, (x, y)) <= link.radius_m:
                yield link

    def place(self, place: Hypothesis) -> Hypothesis:
        """Return a place of the atlas as a place on its floor."""
        if not self.floors:
            return place
        floor, pose = self.on_floor(place.pose)
        return replace(place, pose=pose, floor=floor)

    def probabilities(self, places: Iterable[Hypothesis]) -> dict[str, float]:
        """Return the probability of each floor, from places on floors; without elsewhere."""
        held = dict.fromkeys(self.names, 0.0)
        for place in places if held else ():
            held[place.floor] += place.probability
        return held

    def answered(self, answer: PoseAnswer, places: Iterable[Hypothesis]) -> PoseAnswer:
        """Return an answer with its floor, and those of all places of the atlas."""
        if not self.floors or answer.pose is None:
            return answer
        floor, pose = self.on_floor(answer.pose)
        held = self.probabilities(map(self.place, places))
        return replace(answer, pose=pose, floor=floor, floors=held)

    def drawn(self, belief: Belief) -> Belief:
        """Return a belief with its places in the atlas, for drawing."""
        if not self.floors:
            return belief
        places = (
            replace(place, pose=self.drawn_pose(place.floor, place.pose))
            for place in belief.hypotheses
        )
        return replace(belief, hypotheses=tuple(places))

    def drawn_pose(self, floor: str, pose: PoseTuple) -> PoseTuple:
        """Return a pose in the atlas; that on a floor of another map is returned as it is."""
        return self.in_atlas(floor, pose) if floor in self.names else pose


ONE_MAP = Floors()
