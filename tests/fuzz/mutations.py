"""Valid bytes, damaged as links, disks and strangers damage them."""

import gzip
import lzma
import math
from collections.abc import Callable, Iterator
from typing import Any

import msgspec
from hypothesis import strategies as st

Mutation = Callable[[bytes], bytes]

_PACKERS: dict[str, Mutation] = {
    "plain": bytes,
    "gzip": lambda data: gzip.compress(data, 1),
    "xz": lambda data: lzma.compress(data, preset=0),
}


@st.composite
def mutations(draw: st.DrawFn) -> Mutation:
    """One damage: bytes changed, put in, left out, doubled, or the rest cut off."""
    kind = draw(st.sampled_from(["change", "insert", "remove", "double", "cut"]))
    at, length = draw(st.floats(0.0, 1.0)), draw(st.integers(1, 40))
    junk = draw(st.binary(min_size=1, max_size=8))

    def damaged(data: bytes) -> bytes:
        start = int(at * len(data))
        end = start + length
        match kind:
            case "change":
                return data[:start] + junk + data[start + len(junk) :]
            case "insert":
                return data[:start] + junk + data[start:]
            case "remove":
                return data[:start] + data[end:]
            case "double":
                return data[:end] + data[start:]
            case _:
                return data[:start]

    return damaged


@st.composite
def damaged(draw: st.DrawFn, valid: st.SearchStrategy[bytes], most: int = 3) -> bytes:
    """Valid bytes with up to `most` damages."""
    data = draw(valid)
    for mutate in draw(st.lists(mutations(), max_size=most)):
        data = mutate(data)
    return data


@st.composite
def packed(draw: st.DrawFn, content: st.SearchStrategy[bytes]) -> bytes:
    """A file's bytes as they are, or compressed and perhaps damaged after that."""
    data = _PACKERS[draw(st.sampled_from(sorted(_PACKERS)))](draw(content))
    return draw(damaged(st.just(data), most=1))


# --- numbers inside something that was packed -----------------------------------------------------

_EXTREMES = (
    *(math.nan, math.inf, -math.inf, 1e300, -1e300, 1e-320, 1e9, -0.5, 1.5),
    *(0, -1, -2, 1, 7, 2**31, 2**53 - 1, 2**53, 2**62, 2**63 - 1, -(2**63), 2**64 - 1),
)

Path = tuple[str | int, ...]


@st.composite
def with_other_numbers(draw: st.DrawFn, valid: st.SearchStrategy[bytes]) -> bytes:
    """MessagePack in which one or two numbers, wherever they are, were changed."""
    tree = msgspec.msgpack.decode(draw(valid))
    paths = st.sampled_from(sorted(_numbers(tree), key=str))
    numbers = st.sampled_from(_EXTREMES) | st.floats() | st.integers(-(2**63), 2**64 - 1)
    for path in draw(st.lists(paths, min_size=1, max_size=2, unique=True)):
        _put(tree, path, draw(numbers))
    return msgspec.msgpack.encode(tree)


def _numbers(tree: Any, path: Path = ()) -> Iterator[Path]:
    if isinstance(tree, int | float) and not isinstance(tree, bool):
        yield path
    elif isinstance(tree, dict | list):
        for key, inner in tree.items() if isinstance(tree, dict) else enumerate(tree):
            yield from _numbers(inner, (*path, key))


def _put(tree: Any, path: Path, value: float) -> None:
    *before, last = path
    for key in before:
        tree = tree[key]
    tree[last] = value
