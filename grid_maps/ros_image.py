"""The image of a ROS map: pixels to free, occupied and unknown cells, as nav2_map_server does.

A pixel's shade is the mean of its channels, from 0 (black) to 1 (white); a cell is occupied with
probability 1 - shade (`negate`: shade).

* *trinary*: occupied above `occupied_thresh`, free below `free_thresh`, else unknown. An alpha
  channel counts as one more channel of the mean.
* *scale*: the same without alpha in the mean; pixels that are not opaque are unknown. Cells between
  the thresholds, which map_server publishes as a percentage, are unknown here.
* *raw*: the pixel is the occupancy in percent; 101 to 255 is unknown; `negate` and alpha are
  ignored. The thresholds decide between free and occupied.
"""

import io
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from grid_maps.grid_map import MAX_CELLS, GridMap
from grid_maps.known_part import known_part
from grid_maps.ros_map import RosMapHeader
from particle_filter.arrays import FREE, OCCUPIED, UNKNOWN, Cells
from protocol.errors import MapFileError

_STRIP_ROWS = 512
_IMAGE_MAGICS = (b"P1", b"P2", b"P3", b"P4", b"P5", b"P6", b"\x89PNG", b"BM", b"\xff\xd8", b"GIF8")
_BROKEN_IMAGE = (OSError, ValueError, SyntaxError, EOFError, IndexError, OverflowError)


def is_image(content: bytes) -> bool:
    """Return whether the bytes start like an image file that a map may use."""
    return content.startswith(_IMAGE_MAGICS)


def parse_ros_image(content: bytes, path: Path, header: RosMapHeader) -> GridMap:
    """Read the image that belongs to a header.

    Raises:
        MapFileError: the image is truncated, damaged, too large, or has no free space.
    """
    image = _open(content, path)
    try:
        cells = _cells(image, header)
    except _BROKEN_IMAGE as error:
        raise MapFileError(path, f"the image is cut off or damaged ({error})") from error
    strips = (cells[top : top + _STRIP_ROWS] for top in range(0, len(cells), _STRIP_ROWS))
    if not any(np.any(strip == FREE) for strip in strips):
        problem = (
            f"no free space: no pixel is free with free_thresh {header.free_thresh}, "
            f"negate {int(header.negate)}, mode {header.mode}"
        )
        raise MapFileError(path, problem)
    return known_part(cells, header.resolution, header.origin)


def _open(content: bytes, path: Path) -> Image.Image:
    """Open the image without decoding it, and check its size."""
    pillow_limit = Image.MAX_IMAGE_PIXELS
    Image.MAX_IMAGE_PIXELS = None  # ours is checked below; suppress the warning of Pillow
    try:
        image = Image.open(io.BytesIO(content))
    except UnidentifiedImageError as error:
        raise MapFileError(path, "not an image that can be read; use PGM or PNG") from error
    except _BROKEN_IMAGE as error:
        raise MapFileError(path, f"the image is damaged ({error})") from error
    finally:
        Image.MAX_IMAGE_PIXELS = pillow_limit
    if image.width * image.height > MAX_CELLS:  # unpacked, a PNG of a megabyte may have them
        problem = f"{image.width} x {image.height} pixels; at most {MAX_CELLS} are read"
        raise MapFileError(path, f"{problem}: cut the map or use larger cells")
    return image


def _cells(image: Image.Image, header: RosMapHeader) -> Cells:
    """(rows, cols) cells, the image's last row first."""
    mode = _channel_mode(image)
    opaque_only = header.mode == "scale" and mode in ("LA", "RGBA")
    with_alpha = header.mode == "trinary"
    table = _cell_of_channel_sum(mode, header)
    cells: Cells = np.full((image.height, image.width), UNKNOWN, np.int8)
    left, first, right, last = _known_box(image, table)
    for top in range(first, last, _STRIP_ROWS):
        box = (left, top, right, min(top + _STRIP_ROWS, last))
        pixels = _pixels(image.crop(box), mode)
        strip = table[_channel_sum(pixels, mode, with_alpha=with_alpha)]
        if opaque_only:
            strip[pixels[..., -1] != 255] = UNKNOWN
        cells[image.height - box[3] : image.height - top, left:right] = strip[::-1]
    return cells


def _known_box(image: Image.Image, table: Cells) -> tuple[int, int, int, int]:
    """Left, top, right and bottom of a part of the image beyond which all is unknown.

    Found where a pixel is one byte of grey, as in nearly all maps; else it is the whole image.
    Pillow looks at a pixel in a tenth of the time that numpy takes to translate it.
    """
    if image.mode != "L" or image.has_transparency_data:
        return 0, 0, image.width, image.height
    return image.point((table != UNKNOWN).tolist()).getbbox() or (0, 0, 0, 0)


def _channel_mode(image: Image.Image) -> str:
    """Return the Pillow mode to decode to: L, LA, I, RGB or RGBA."""
    if image.mode.startswith("I"):
        return "I"
    if image.mode == "F":
        raise ValueError("pixels are floating-point numbers")
    grey = image.mode in ("1", "L", "LA", "La")
    if image.has_transparency_data:
        return "LA" if grey else "RGBA"
    return "L" if grey else "RGB"


def _pixels(strip: Image.Image, mode: str) -> NDArray[np.integer]:
    """Return (rows, cols, channels) values, of an integer type wide enough for their sum."""
    if mode not in ("I", strip.mode):
        strip = strip.convert(mode)
    pixels = np.asarray(strip)
    if pixels.ndim == 2:
        pixels = pixels[..., np.newaxis]
    if pixels.dtype == np.uint8 and mode == "L":
        return pixels
    return np.asarray(np.clip(pixels, 0, 65_535), np.int32)


def _channel_sum(
    pixels: NDArray[np.integer], mode: str, *, with_alpha: bool
) -> NDArray[np.integer]:
    """Return (rows, cols) sums over red, green, blue and perhaps alpha; grey counts three times."""
    if mode in ("L", "I"):
        return pixels[..., 0]
    if mode == "LA":
        return 3 * pixels[..., 0] + (pixels[..., 1] if with_alpha else 0)
    if mode == "RGBA" and not with_alpha:
        pixels = pixels[..., :3]
    return np.asarray(pixels.sum(axis=-1, dtype=np.int32))


def _cell_of_channel_sum(mode: str, header: RosMapHeader) -> Cells:
    """Return a lookup table from a channel sum to a cell's state, (largest sum + 1,)."""
    if mode == "I":
        white = 65_535
    elif mode == "L":
        white = 255
    else:
        with_alpha = mode in ("LA", "RGBA") and header.mode == "trinary"
        white = 255 * (4 if with_alpha else 3)
    shade = np.arange(white + 1) / white
    if header.mode == "raw":
        percent = np.rint(shade * 255.0)
        occupied = percent / 100.0
        unknown = percent > 100.0
    else:
        occupied = shade if header.negate else 1.0 - shade
        unknown = np.zeros(white + 1, bool)
    table: Cells = np.full(white + 1, UNKNOWN, np.int8)
    table[occupied < header.free_thresh] = FREE
    table[occupied > header.occupied_thresh] = OCCUPIED
    table[unknown] = UNKNOWN
    return table
