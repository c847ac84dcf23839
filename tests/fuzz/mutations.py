"""Valid bytes, damaged as links, disks and strangers damage them."""

import gzip
import lzma
from collections.abc import Callable

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
