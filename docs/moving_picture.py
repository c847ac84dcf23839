"""Writes frames into one picture that moves."""

from collections.abc import Iterable
from pathlib import Path

from PIL import Image


def write_webp(
    file: Path, frames: Iterable[Image.Image], *, frame_ms: int, last_frame_ms: int, quality: int
) -> None:
    """Write `file`, which plays for ever and rests on its last frame."""
    first, *others = (frame.convert("RGB") for frame in frames)
    first.save(
        file,
        save_all=True,
        append_images=others,
        duration=[frame_ms] * len(others) + [last_frame_ms],
        loop=0,
        quality=quality,
        method=6,
    )
