"""The frames of the last steps, for looking back."""

import zlib
from collections import deque
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple, TypeAlias

import msgspec

MAX_STEPS = 10_000
MAX_BYTES = 20_000_000
"""Of all archived frames; with very many clusters, fewer steps fit."""
LOOK_BACK_STEPS = 100
"""A frame holds for this many later steps: particles arrive about every tenth step."""
PACKED_TOGETHER_BYTES = 32_000
"""About a second of frames: similar ones, whose set-up costs more than packing one."""
_FAST = 1

ArchiveEntry: TypeAlias = tuple[int, str, msgspec.Raw]
"""Step, topic, encoded frame."""
_ENTRIES = msgspec.json.Decoder(list[ArchiveEntry])


class _Pack(NamedTuple):
    first_step: int
    last_step: int
    packed: bytes


class StepArchive:
    """Keeps compressed frames by step and topic; drops the oldest.

    Args:
        max_steps: most steps between the first and the last.
        max_bytes: of the packed frames.
    """

    def __init__(self, max_steps: int = MAX_STEPS, max_bytes: int = MAX_BYTES) -> None:
        self.max_steps, self._max_bytes = max_steps, max_bytes
        self._pack_bytes = min(PACKED_TOGETHER_BYTES, max_bytes // 8)
        self.clear()

    def clear(self) -> None:
        """Drop all frames."""
        self._packs: deque[_Pack] = deque()
        self._packed_bytes = self._newest_bytes = 0
        self._newest: list[ArchiveEntry] = []
        """Not packed yet."""
        self._newest_step = 0

    def add(self, step: int, topic: str, frame: Any) -> None:
        """Keep a frame; it holds for its step and later ones, until the next of its topic.

        Args:
            step: not less than in earlier calls.
            topic: see `Picture`.
            frame: a JSON object.
        """
        encoded = msgspec.json.encode(frame)
        self._newest.append((step, topic, msgspec.Raw(encoded)))
        self._newest_bytes += len(encoded)
        self._newest_step = step
        if self._newest_bytes >= self._pack_bytes:
            self._pack()
        given_way = step - self.max_steps
        while self._packs and (
            self._packed_bytes > self._max_bytes or self._packs[0].last_step <= given_way
        ):
            self._packed_bytes -= len(self._packs.popleft().packed)

    def at(self, step: int) -> dict[str, msgspec.Raw]:
        """Return the newest encoded frame of each topic that is not newer than a step."""
        found: dict[str, msgspec.Raw] = {}
        oldest = max(step - LOOK_BACK_STEPS, self._newest_step - self.max_steps + 1)
        for entries in self._entries_between(oldest, step):
            for kept_step, topic, frame in reversed(entries):
                if oldest <= kept_step <= step:
                    found.setdefault(topic, frame)
        return found

    def everything(self) -> list[ArchiveEntry]:
        """All entries in the order of their steps."""
        packs = [_ENTRIES.decode(zlib.decompress(pack.packed)) for pack in self._packs]
        return [entry for entries in (*packs, self._newest) for entry in entries]

    def _entries_between(self, first: int, last: int) -> Iterator[Sequence[ArchiveEntry]]:
        """Yield the entries of these steps and some around them, the newest pack first."""
        yield self._newest
        for pack in reversed(self._packs):
            if pack.last_step < first:
                return
            if pack.first_step <= last:
                yield _ENTRIES.decode(zlib.decompress(pack.packed))

    def _pack(self) -> None:
        packed = zlib.compress(msgspec.json.encode(self._newest), _FAST)
        self._packs.append(_Pack(self._newest[0][0], self._newest[-1][0], packed))
        self._packed_bytes += len(packed)
        self._newest, self._newest_bytes = [], 0
