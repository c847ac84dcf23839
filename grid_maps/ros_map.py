"""The YAML file of a ROS map, as map_server and nav2 read it; for its image see `ros_image`."""

import math
from collections.abc import Hashable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, cast

import yaml

from process_runtime.yaml_text import refuse_aliases
from protocol.errors import MapFileError
from protocol.message import PoseTuple

MAX_HEADER_BYTES = 64 * 1024

Mode = Literal["trinary", "scale", "raw"]


@dataclass(frozen=True)
class RosMapHeader:
    """The YAML file's content, under its own names.

    Args:
        image: the image file.
        resolution: side of a cell [m].
        origin: pose of the image's lower left corner in the map frame.
        negate: whether light is occupied and dark is free.
        occupied_thresh: occupied above this probability.
        free_thresh: free below this probability.
        mode: conversion of a pixel to a probability.
    """

    image: Path
    resolution: float
    origin: PoseTuple
    negate: bool
    occupied_thresh: float
    free_thresh: float
    mode: Mode


def parse_ros_header(content: bytes, path: Path) -> RosMapHeader:
    """Read the YAML file. It requires the same keys as map_server and ignores others.

    Raises:
        MapFileError: with the line: not YAML, not a mapping, or a key is missing, of the wrong
            type or out of range.
    """
    fields = _Fields(content, path)
    header = RosMapHeader(
        image=path.parent / fields.text("image"),
        resolution=fields.number("resolution"),
        origin=fields.pose("origin"),
        negate=fields.flag("negate"),
        occupied_thresh=fields.number("occupied_thresh"),
        free_thresh=fields.number("free_thresh"),
        mode=fields.mode(),
    )
    if not 0.0 < header.resolution < 100.0:
        raise fields.wrong("resolution", "must be metres a cell, above 0 and below 100")
    for key in ("occupied_thresh", "free_thresh"):
        if not 0.0 <= getattr(header, key) <= 1.0:
            raise fields.wrong(key, "must be a probability, 0 to 1")
    if header.free_thresh > header.occupied_thresh:
        raise fields.wrong("free_thresh", "must not exceed occupied_thresh; are they swapped?")
    return header


class _Fields:
    """The mapping of a YAML file, with the line of each key for errors."""

    def __init__(self, content: bytes, path: Path) -> None:
        self._path = path
        self._values, self._lines = _mapping(content, path)

    def wrong(self, key: str, problem: str) -> MapFileError:
        """Return the error for a key with an invalid value."""
        found = f"{key}: {self._values[key]!r}"
        return MapFileError(self._path, f"{found} {problem}", line=self._lines.get(key))

    def text(self, key: str) -> str:
        value = self._required(key)
        if not isinstance(value, str) or not value:
            raise self.wrong(key, "must be a file name")
        return value

    def number(self, key: str) -> float:
        number = _number(self._required(key))
        if number is None:
            raise self.wrong(key, "must be a number")
        return number

    def pose(self, key: str) -> PoseTuple:
        value = self._required(key)
        numbers = [_number(item) for item in value] if isinstance(value, list) else []
        match numbers:
            case [float(x), float(y), float(heading)]:
                return x, y, heading
        raise self.wrong(key, "must be three numbers: [x, y, yaw]")

    def flag(self, key: str) -> bool:
        value = self._required(key)
        if value not in (0, 1):  # True and False are 1 and 0
            raise self.wrong(key, "must be 0 or 1")
        return bool(value)

    def mode(self) -> Mode:
        if "mode" not in self._values:
            return "trinary"
        if self._values["mode"] not in ("trinary", "scale", "raw"):
            raise self.wrong("mode", "must be trinary, scale or raw")
        return cast(Mode, self._values["mode"])

    def _required(self, key: str) -> Any:
        if key not in self._values:
            problem = f"key {key!r} is missing; map_server requires it"
            raise MapFileError(self._path, problem)
        return self._values[key]


def _mapping(content: bytes, path: Path) -> tuple[dict[Hashable, Any], dict[str, int]]:
    """Return the values and the lines by key."""
    if len(content) > MAX_HEADER_BYTES:
        raise MapFileError(path, f"{len(content)} bytes: a map_server file has some hundred")
    try:
        refuse_aliases(content, path, MapFileError)
        loader = yaml.SafeLoader(content)
        node = loader.get_single_node()
        if not isinstance(node, yaml.MappingNode):
            problem = "not a map: neither a map_server YAML file nor of the wean.dat format"
            raise MapFileError(path, problem)
        lines = {str(key.value): key.start_mark.line + 1 for key, _ in node.value}
        return loader.construct_mapping(node, deep=True), lines
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else None
        raise MapFileError(path, f"not YAML: {error.problem}", line=line) from error
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        first_line = str(error).splitlines()[0]
        raise MapFileError(path, f"not a YAML text: {first_line}") from error


def _number(value: object) -> float | None:
    """Return a finite number, or None; YAML 1.1 reads 5e-2 as text, ROS as a number."""
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        return None
    try:
        number = float(value)
    except (ValueError, OverflowError):
        return None
    return number if math.isfinite(number) else None
