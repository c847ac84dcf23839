"""Reads maps of ROS's map_server, a YAML file and an image, as nav2_map_server does.

A pixel's shade is the mean of its channels, from 0 (black) to 1 (white); a cell is occupied with
probability 1 - shade (`negate`: shade).

* *trinary*: occupied above `occupied_thresh`, free below `free_thresh`, else unknown.
* *scale*: between the thresholds, map_server publishes a percentage, of which `cells_of` decides.
* *raw*: the pixel is the occupancy in percent; 101 to 255 is unknown; `negate` and alpha are
  ignored. The thresholds decide between free and occupied.

Except in *raw*, pixels that are not opaque are unknown.
"""

import io
import math
import re
from pathlib import Path
from typing import Annotated, Literal, TypeAlias

import msgspec
import numpy as np
from PIL import Image, UnidentifiedImageError

from clustermcl.filter.arrays import FREE, OCCUPIED, UNKNOWN, Cells
from clustermcl.protocol.conversion import converted
from clustermcl.protocol.errors import MapFileError, printable
from clustermcl.protocol.message import Coordinate, PoseTuple
from clustermcl.recordings.maps.grid_map import MAX_CELLS, GridMap, cells_of, known_part
from clustermcl.runtime.compressed import read_decompressed, too_long_problem
from clustermcl.runtime.output_files import write_output_file
from clustermcl.runtime.yaml_text import yaml_of

MAX_HEADER_BYTES = 64 * 1024
_KEY = re.compile(r"`\$\.(\w+)")
_STRIP_ROWS = 512
_SHADES = {FREE: 254, OCCUPIED: 0, UNKNOWN: 205}
_UNKNOWN_GREY, _MIN_GREY_SHARE = 205, 0.02
_FORMATS = ("PPM", "PNG", "BMP", "JPEG", "GIF")  # to read EPS, Pillow would start Ghostscript
_IMAGE_MAGICS = (b"P1", b"P2", b"P3", b"P4", b"P5", b"P6", b"\x89PNG", b"BM", b"\xff\xd8", b"GIF8")
_BROKEN_IMAGE = (OSError, ValueError, SyntaxError, EOFError, IndexError, OverflowError)

_Probability: TypeAlias = Annotated[float, msgspec.Meta(ge=0.0, le=1.0)]


class _Header(msgspec.Struct, frozen=True):
    image: Annotated[str, msgspec.Meta(min_length=1)]
    resolution: Annotated[float, msgspec.Meta(gt=0.0, lt=100.0)]
    """Side of a cell [m]."""
    origin: tuple[Coordinate, Coordinate, float]
    """Pose of the image's lower left corner in the map frame."""
    negate: bool
    occupied_thresh: _Probability
    free_thresh: _Probability
    mode: Literal["trinary", "scale", "raw"] = "trinary"

    def __post_init__(self) -> None:
        if self.free_thresh > self.occupied_thresh:
            raise ValueError("free_thresh must not exceed occupied_thresh; are they swapped?")
        if math.isinf(self.origin[2]):
            raise ValueError("the yaw of `origin` is infinite")

    @property
    def pose(self) -> PoseTuple:
        """The origin; map_saver of ROS 1 writes NaN as heading for an invalid quaternion."""
        x, y, heading = self.origin
        return x, y, 0.0 if math.isnan(heading) else heading


def load_ros_map(content: bytes, path: Path) -> GridMap:
    """Read a map of map_server from its YAML file; the image may be packed by gzip or xz.

    Raises:
        MapFileError: `content` is an image or not such a YAML file, a key is missing or invalid,
            or the image is truncated, damaged, too large, or without free space.
    """
    if content.startswith(_IMAGE_MAGICS):
        raise MapFileError(path, "is an image; name the YAML file that belongs to it")
    header = _header(content, path)
    named = path.parent / header.image
    for image in (named, Path(f"{named}.gz"), Path(f"{named}.xz")):
        if image.is_file():
            return _grid_map(read_decompressed(image, MapFileError), image, header)
    beside = path.parent / named.name
    remedy = "put it there or correct 'image:'"
    if beside.is_file():
        remedy = f"{beside} does: write 'image: {named.name}'"
    raise MapFileError(path, f"its image {named} does not exist; {remedy}")


def save_ros_map(grid_map: GridMap, path: Path) -> None:
    """Write a map as a YAML file, and beside it a PNG with the shades of map_saver.

    Raises:
        OutputError: a file cannot be written.
    """
    shades = np.array([_SHADES[FREE], _SHADES[OCCUPIED], _SHADES[UNKNOWN]], np.uint8)
    image, png = path.with_suffix(".png"), io.BytesIO()
    Image.fromarray(shades[grid_map.cells[::-1]]).save(png, "PNG")
    write_output_file(image, png.getvalue())
    origin = ", ".join(map(repr, grid_map.map_from_grid))
    write_output_file(
        path,
        f"image: {image.name}\nmode: trinary\nresolution: {grid_map.cell_m!r}\n"
        f"origin: [{origin}]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n",
    )


def _header(content: bytes, path: Path) -> _Header:
    """Parse and check the YAML file; as in map_server, keys are required, and others ignored."""
    if len(content) > MAX_HEADER_BYTES:
        raise MapFileError(path, too_long_problem(MAX_HEADER_BYTES))
    values, lines = yaml_of(content, path, MapFileError, is_unique=True)
    if isinstance(values, dict) and isinstance(values.get("mode"), str):
        values["mode"] = values["mode"].lower()
    try:  # not strict: `negate` is 0 or 1
        return converted(values, _Header, strict=False)
    except (ValueError, OverflowError, RecursionError) as error:
        named = _KEY.search(str(error))
        problem = f"not a file of map_server: {printable(str(error))}"
        raise MapFileError(path, problem, line=lines.get(named[1]) if named else None) from None


def _grid_map(content: bytes, path: Path, header: _Header) -> GridMap:
    image = _open(content, path)
    try:
        cells, odd = _cells(image, header)
        image.close()  # it takes as much memory as the cells
    except _BROKEN_IMAGE as error:
        raise MapFileError(path, f"the image is cut off or damaged ({error})") from error
    if not any(np.any(row == FREE) for row in cells):
        problem = (
            f"no free space: no pixel is free with free_thresh {header.free_thresh}, "
            f"negate {int(header.negate)}, mode {header.mode}"
        )
        raise MapFileError(path, problem)
    yaw = "origin: its yaw is not a number and is taken as 0; write [x, y, 0]"
    remarks = odd, yaw if math.isnan(header.origin[2]) else ""
    return known_part(cells, header.resolution, header.pose).with_remarks(*remarks)


def _open(content: bytes, path: Path) -> Image.Image:
    """Open an image and check its size, without decoding it."""
    pillow_limit = Image.MAX_IMAGE_PIXELS
    Image.MAX_IMAGE_PIXELS = None  # ours is checked below; suppress the warning of Pillow
    try:
        image = Image.open(io.BytesIO(content), formats=_FORMATS)
    except UnidentifiedImageError as error:
        raise MapFileError(path, "not an image that can be read; use PGM or PNG") from error
    except _BROKEN_IMAGE as error:
        raise MapFileError(path, f"the image is damaged ({error})") from error
    finally:
        Image.MAX_IMAGE_PIXELS = pillow_limit
    if image.width * image.height > MAX_CELLS:  # a PNG of a megabyte may have more
        problem = f"{image.width} x {image.height} pixels; at most {MAX_CELLS} are read"
        raise MapFileError(path, f"{problem}: crop the map or use larger cells")
    return image


def _cells(image: Image.Image, header: _Header) -> tuple[Cells, str]:
    """Return the cells, (rows, cols), with the image's last row first, and a remark, or ""."""
    mode = _pixel_mode(image)
    white = {"L": 255, "I": 65_535}.get(mode, 3 * 255)
    table = _cell_of_sum(white, header)
    unknown_grey = white * _UNKNOWN_GREY // 255
    grey_count = 0
    cells: Cells = np.empty((image.height, image.width), np.int8)
    for top in range(0, image.height, _STRIP_ROWS):
        bottom = min(top + _STRIP_ROWS, image.height)
        part = image.crop((0, top, image.width, bottom))
        pixels = np.asarray(part if mode == "I" else part.convert(mode))
        sums = pixels if pixels.ndim == 2 else pixels[..., :3].sum(axis=-1, dtype=np.int32)
        strip = table[np.clip(sums, 0, len(table) - 1)]
        grey_count += int(np.count_nonzero(sums == unknown_grey))
        if header.mode != "raw" and mode == "RGBA":
            strip[pixels[..., -1] != 255] = UNKNOWN
        cells[image.height - bottom : image.height - top] = strip[::-1]
    if header.mode != "trinary" or header.negate or table[unknown_grey] != FREE:
        return cells, ""
    share = grey_count / cells.size
    problem = (
        f"{share:.0%} of the pixels are grey {_UNKNOWN_GREY}, with which map_saver marks unknown"
    )
    remedy = f"free_thresh {header.free_thresh} makes them free: write free_thresh: 0.196"
    return cells, f"{problem}; {remedy}" if share >= _MIN_GREY_SHARE else ""


def _pixel_mode(image: Image.Image) -> str:
    if image.mode.startswith("I"):
        return "I"
    if image.mode == "F":
        raise ValueError("pixels are floating-point numbers")
    if image.has_transparency_data:
        return "RGBA"
    return "L" if image.mode in ("1", "L") else "RGB"


def _cell_of_sum(white: int, header: _Header) -> Cells:
    """Return a lookup table from the sum of a pixel's channels to a cell's state, (white + 1,)."""
    shade = np.arange(white + 1) / white
    occupied = shade if header.negate else 1.0 - shade
    if header.mode == "raw":
        occupied = np.rint(shade * 255.0) / 100.0
    table: Cells = np.full(white + 1, UNKNOWN, np.int8)
    if header.mode == "scale":
        span = max(header.occupied_thresh - header.free_thresh, 1e-9)
        percent = np.rint(np.clip((occupied - header.free_thresh) / span, 0.0, 1.0) * 100.0)
        return cells_of(percent.astype(np.int8))
    table[occupied < header.free_thresh] = FREE
    table[occupied > header.occupied_thresh] = OCCUPIED
    if header.mode == "raw":
        table[occupied > 1.0] = UNKNOWN
    return table
