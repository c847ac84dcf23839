"""An archive of the page's frames, for past steps."""

import zlib
from collections import deque
from typing import Any, NamedTuple, TypeAlias

import msgspec

from clustermcl.protocol.conversion import decoded

MAX_STEPS = 10_000
MAX_BYTES = 20_000_000
"""Limit for all archived frames, compressed; with very many clusters, fewer steps fit."""
LOOK_BACK_STEPS = 100
"""Number of steps for which a frame is shown if its topic gets no newer frame."""
PACKED_TOGETHER_BYTES = 32_000
"""Size of a group of frames, compressed together because single frames compress badly."""
_FAST = 1

ArchiveEntry: TypeAlias = tuple[int, str, msgspec.Raw]


class _Pack(NamedTuple):
    first_step: int
    last_step: int
    packed: bytes


class StepArchive:
    """The frames of past steps, compressed; the oldest are dropped."""

    def __init__(self, max_steps: int = MAX_STEPS, max_bytes: int = MAX_BYTES) -> None:
        self.max_steps, self._max_bytes = max_steps, max_bytes
        self._pack_bytes = min(PACKED_TOGETHER_BYTES, max_bytes // 8)
        self.clear()

    def clear(self) -> None:
        self._packs: deque[_Pack] = deque()
        self._packed_bytes = self._newest_bytes = 0
        self._newest: list[ArchiveEntry] = []
        self._newest_step = 0

    def add(self, step: int, topic: str, frame: Any) -> None:
        """Store a frame of a step, whose number is not less than in earlier calls."""
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
        """Return each topic's newest encoded frame at a step, if it has one for that step."""
        found: dict[str, msgspec.Raw] = {}
        oldest = max(step - LOOK_BACK_STEPS, self._newest_step - self.max_steps + 1)
        packs = (p for p in reversed(self._packs) if p.last_step >= oldest and p.first_step <= step)
        for entries in (self._newest, *map(_unpacked, packs)):
            for kept_step, topic, frame in reversed(entries):
                if oldest <= kept_step <= step:
                    found.setdefault(topic, frame)
        return found

    def everything(self) -> list[ArchiveEntry]:
        packs = [_unpacked(pack) for pack in self._packs]
        return [entry for entries in (*packs, self._newest) for entry in entries]

    def _pack(self) -> None:
        packed = zlib.compress(msgspec.json.encode(self._newest), _FAST)
        self._packs.append(_Pack(self._newest[0][0], self._newest[-1][0], packed))
        self._packed_bytes += len(packed)
        self._newest, self._newest_bytes = [], 0


def _unpacked(pack: _Pack) -> list[ArchiveEntry]:
    return decoded(zlib.decompress(pack.packed), list[ArchiveEntry], msgspec.json)
