"""The last steps as they were drawn, for those who look back."""

import zlib
from collections import deque
from typing import Any, NamedTuple

import msgspec

MAX_STEPS = 10_000
MAX_BYTES = 20_000_000
"""Of all that is kept; with very many clusters, fewer steps fit."""
LOOK_BACK_STEPS = 100
"""So long a frame stands for the steps after it: particles come every tenth step or so."""
_FAST, _WINDOW_BITS, _MEMORY = 1, 11, 4
"""Of deflate: frames have some 2 kB, and its usual window takes longer to set up than to use."""


class _Kept(NamedTuple):
    step: int
    topic: str
    packed: bytes


class StepArchive:
    """Keeps frames by step and topic, packed; the oldest give way.

    Args:
        max_steps: that lie between the first and the last.
        max_bytes: of the packed frames.
    """

    def __init__(self, max_steps: int = MAX_STEPS, max_bytes: int = MAX_BYTES) -> None:
        self.max_steps, self._max_bytes = max_steps, max_bytes
        self._kept: deque[_Kept] = deque()
        self._bytes = 0

    def add(self, step: int, topic: str, frame: Any) -> None:
        """Keep a frame; it stands for its step and those after it, until the next of its topic.

        Args:
            step: not lower than any before.
            topic: as the page knows it.
            frame: what is drawn.
        """
        packed = _packed(msgspec.json.encode(frame))
        self._kept.append(_Kept(step, topic, packed))
        self._bytes += len(packed)
        oldest = step - self.max_steps
        while self._kept and (self._bytes > self._max_bytes or self._kept[0].step <= oldest):
            self._bytes -= len(self._kept.popleft().packed)

    def clear(self) -> None:
        """Forget all."""
        self._kept.clear()
        self._bytes = 0

    def at(self, step: int) -> dict[str, msgspec.Raw]:
        """The newest frame of each topic that is not newer than a step, encoded."""
        found: dict[str, msgspec.Raw] = {}
        for kept in reversed(self._kept):
            if kept.step > step or kept.topic in found:
                continue
            if kept.step < step - LOOK_BACK_STEPS:
                break
            found[kept.topic] = msgspec.Raw(zlib.decompress(kept.packed, -_WINDOW_BITS))
        return found


def _packed(encoded: bytes) -> bytes:
    packer = zlib.compressobj(_FAST, zlib.DEFLATED, -_WINDOW_BITS, _MEMORY)
    return packer.compress(encoded) + packer.flush()
