"""Landmarks of a map: a YAML file next to it, with names and positions."""

from pathlib import Path
from typing import Annotated

import msgspec

from clustermcl.protocol.conversion import converted
from clustermcl.protocol.errors import LandmarksFileError
from clustermcl.protocol.floors import ONE_MAP, Floors
from clustermcl.protocol.message import Coordinate, Id
from clustermcl.protocol.steps import MAX_LANDMARKS, Landmark, Sigma
from clustermcl.runtime.compressed import read_decompressed
from clustermcl.runtime.yaml_text import yaml_of

LANDMARKS_FILE = "landmarks.yaml"
_MAX_BYTES = 2**17
"""For `MAX_LANDMARKS` with long names; PyYAML needs 1 s for it."""


class _Entry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    x: Coordinate
    y: Coordinate
    floor: str = ""
    id: Id | None = None
    class_: Id | None = msgspec.field(default=None, name="class")
    sigma: Sigma = 0.05

    def __post_init__(self) -> None:
        if (self.id is None) == (self.class_ is None):
            raise ValueError("a landmark needs either an id or a class")


class _File(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    landmarks: Annotated[list[_Entry], msgspec.Meta(max_length=MAX_LANDMARKS)]


def load_landmarks(path: Path | str, floors: Floors = ONE_MAP) -> tuple[Landmark, ...]:
    """Read a landmarks file.

    The file has a list ``landmarks``; each has ``id``, or a ``class`` that it shares with others,
    ``x`` and ``y`` in the map [m], and optionally the standard deviation ``sigma`` [m]. In a
    building, each has its ``floor``.

    Args:
        path: the file.
        floors: those of the map (`GridMap.floors`); landmarks are returned in its atlas.

    Raises:
        LandmarksFileError: the file is unreadable or damaged, a field is unknown, missing or out of
            range, or an id is used twice.
    """
    path = Path(path)
    content = read_decompressed(path, LandmarksFileError, _MAX_BYTES)
    written, _ = yaml_of(content, path, LandmarksFileError, is_unique=True)
    try:
        entries = converted(written, _File).landmarks
    except (ValueError, RecursionError) as error:
        raise LandmarksFileError(path, f"not a landmarks file: {error}") from None
    found: list[Landmark] = []
    names: dict[str, bool] = {}
    """Whether each name is a class."""
    for number, entry in enumerate(entries, 1):
        name = entry.id or entry.class_ or ""
        try:
            if name in names and not (names[name] and entry.class_):
                raise ValueError(f"the id {name!r} is used before; give each its own")
            x, y, _ = floors.in_atlas(entry.floor, (entry.x, entry.y, 0.0))
        except ValueError as error:
            raise LandmarksFileError(path, f"landmark {number}: {error}") from None
        names[name] = entry.id is None
        found.append(Landmark(name=name, x=x, y=y, sigma=entry.sigma))
    return tuple(found)


def landmarks_of_map(map_file: Path | str, floors: Floors = ONE_MAP) -> tuple[Landmark, ...]:
    """Return the landmarks of the file in a map's folder; none if there is no file."""
    path = Path(map_file).parent / LANDMARKS_FILE
    return load_landmarks(path, floors) if path.exists() else ()
