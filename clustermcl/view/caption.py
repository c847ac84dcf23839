"""Adds a title, the date, a scale bar and a legend to a drawing of the map."""

import math
import time
from collections.abc import Iterable
from typing import Literal, NamedTuple, TypeAlias

from PIL import Image, ImageDraw, ImageFont

INK, _PAPER = "#1a2027", "#ffffff"
_TITLE_PX, _TEXT_PX, _MARK_PX, _GAP_PX = 44, 30, 11, 24
_LEAST_WIDTH_PX = 1400
"""Least width of a captioned drawing: the map of a corridor has no room for a title."""
_LONGEST_BAR = 0.2
"""Limit for the scale bar, as a share of the width."""

Mark: TypeAlias = Literal["disc", "ring", "diamond", "arrow", "outlined arrow"]


class Key(NamedTuple):
    """An entry of a legend."""

    mark: Mark
    colour: str
    words: str


def captioned(
    canvas: Image.Image, px_per_m: float, title: str, legend: Iterable[Key]
) -> Image.Image:
    """Return a drawing below a title, the date and a scale bar, and above a legend."""
    width = max(canvas.width, _LEAST_WIDTH_PX)
    large, small = (ImageFont.load_default(size=size) for size in (_TITLE_PX, _TEXT_PX))
    top, line = 3 * _GAP_PX + _TITLE_PX + _TEXT_PX, _TEXT_PX + _GAP_PX
    bottom = top + canvas.height
    left, y, keys = _GAP_PX, bottom + line // 2 + _GAP_PX // 2, []
    for key in legend:
        right = left + 3 * _MARK_PX + small.getlength(key.words)
        if right > width - _GAP_PX and left > _GAP_PX:
            left, y, right = _GAP_PX, y + line, right - left + _GAP_PX
        keys.append((key, left, y))
        left = round(right) + 2 * _GAP_PX
    page = Image.new("RGB", (width, y + line), _PAPER)
    page.paste(canvas, ((width - canvas.width) // 2, top))
    draw = ImageDraw.Draw(page)
    while large.getlength(title) > width - 2 * _GAP_PX:
        title = title[:-2] + "…"
    draw.text((_GAP_PX, _GAP_PX), title, fill=INK, font=large)
    base = top - _GAP_PX
    date = time.strftime("%Y-%m-%d %H:%M %Z")
    draw.text((_GAP_PX, base), date, fill=INK, font=small, anchor="ls")
    _draw_scale(draw, (width - _GAP_PX, base), _LONGEST_BAR * width, px_per_m, small)
    for key, x, y in keys:
        _draw_mark(draw, key, x + _MARK_PX, y)
        draw.text((x + 3 * _MARK_PX, y), key.words, fill=INK, font=small, anchor="lm")
    return page


def _draw_scale(
    draw: ImageDraw.ImageDraw,
    right_low: tuple[int, int],
    longest_px: float,
    px_per_m: float,
    font: ImageFont.FreeTypeFont | ImageFont.ImageFont,
) -> None:
    """Draw a bar of 1, 2 or 5 times a power of ten metres, with its length to the left."""
    most_m = longest_px / px_per_m
    tens = 10.0 ** math.floor(math.log10(most_m))
    length_m = tens * max(step for step in (1, 2, 5) if step * tens <= most_m)
    right, low = right_low
    left = right - round(length_m * px_per_m)
    draw.line((left, low - 12, left, low, right, low, right, low - 12), fill=INK, width=4)
    draw.text((left - _GAP_PX, low), f"{length_m:g} m", fill=INK, font=font, anchor="rs")


def _draw_mark(draw: ImageDraw.ImageDraw, key: Key, x: int, y: int) -> None:
    size = _MARK_PX
    arrow = [(x + size, y), (x - size, y - size), (x - size, y + size)]
    match key.mark:
        case "disc":
            draw.circle((x, y), size, fill=key.colour)
        case "ring":
            draw.circle((x, y), size, outline=key.colour, width=5)
        case "diamond":
            draw.regular_polygon((x, y, size), 4, rotation=45, fill=key.colour)
        case "arrow":
            draw.polygon(arrow, fill=key.colour)
        case "outlined arrow":
            draw.polygon(arrow, outline=key.colour, width=5)
