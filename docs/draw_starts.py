"""Draws docs/starts.png from docs/experiments/starts: when each robot that started anywhere knew.

python docs/draw_starts.py
"""

import json
from collections import Counter
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont

HERE = Path(__file__).parent
NAMES = {
    "intel": "Intel", "fr101": "fr101", "aces": "ACES", "fr079": "fr079",
    "belgioioso": "Belgioioso", "edmonton": "Edmonton", "fhw": "FHW",
    "wean-1": "Wean Hall 1", "wean-2": "Wean Hall 2", "wean-3": "Wean Hall 3",
}  # fmt: skip
PAPER, INK, FAINT, GROUND = (255, 255, 255), (40, 44, 52), (110, 115, 125), (226, 229, 234)
RIGHT, NOT_YET = (0, 114, 178), (213, 94, 0)
"""Of Okabe and Ito's: the colour-blind tell them apart."""
STEPS, FINER, DOTS_HIGH = 60, 2, 8
"""FINER: drawn so many times finer than shown, which makes edges smooth."""
WIDTH_PX, ROW_PX, LEFT_PX, TOP_PX, STEP_PX, DOT_PX = 860, 46, 110, 34, 10, 2.3
NEVER_PX = LEFT_PX + (STEPS + 3) * STEP_PX


def main() -> None:
    """A row for each recording; in it a dot for each start, at its step."""
    height = TOP_PX + ROW_PX * len(NAMES) + 36
    picture = Image.new("RGB", (WIDTH_PX * FINER, height * FINER), PAPER)
    draw = ImageDraw.Draw(picture)
    _text(draw, LEFT_PX, 8, "each dot is one start: sure and right at step ...", INK, 14)
    _text(draw, NEVER_PX, 8, "not by 60", NOT_YET, 14)
    for step in range(0, STEPS + 1, 10):
        x, low = LEFT_PX + step * STEP_PX, height - 32
        draw.line(_scaled(x, TOP_PX, x, low), GROUND, FINER)
        _text(draw, x, low + 6, str(step), FAINT, 12, anchor="mt")
    for row, (file, name) in enumerate(NAMES.items()):
        low = TOP_PX + (row + 1) * ROW_PX - 6
        _text(draw, LEFT_PX - 12, low, name, INK, 13, anchor="rs")
        draw.line(_scaled(LEFT_PX, low + 3, LEFT_PX + STEPS * STEP_PX, low + 3), GROUND, FINER)
        runs = json.loads((HERE / "experiments" / "starts" / f"{file}.json").read_text())["runs"]
        _dots(draw, low, [run["sure_and_right_at_step"] for run in runs])
    size = (WIDTH_PX, height)
    shown = picture.resize(size, Image.Resampling.LANCZOS).quantize(64)
    shown.save(HERE / "starts.png", optimize=True)


def _dots(draw: ImageDraw.ImageDraw, low: float, known_at: list[int | None]) -> None:
    """Those of one recording, on one another where steps are equal."""
    there = Counter[float]()
    for step in known_at:
        left = NEVER_PX if step is None else LEFT_PX + step * STEP_PX
        count = there[left]
        there[left] += 1
        column, level = divmod(count, DOTS_HIGH)
        x, y = left + column * (2 * DOT_PX + 0.5), low - level * (2 * DOT_PX + 0.5) - DOT_PX
        box = _scaled(x - DOT_PX, y - DOT_PX, x + DOT_PX, y + DOT_PX)
        draw.ellipse(box, NOT_YET if step is None else RIGHT)


def _scaled(*shown_px: float) -> tuple[float, ...]:
    return tuple(FINER * value for value in shown_px)


def _text(
    draw: ImageDraw.ImageDraw, x: float, y: float, words: str, ink: tuple[int, int, int],
    points: int, anchor: str = "la",
) -> None:  # fmt: skip
    draw.text(_scaled(x, y), words, ink, ImageFont.load_default(points * FINER), anchor=anchor)


if __name__ == "__main__":
    main()
