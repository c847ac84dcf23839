import math
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from msgspec.structs import replace

from clustermcl.filter.arrays import FREE, OCCUPIED, UNKNOWN, Cells
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.errors import MalformedMessageError
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import Landmark, MapMessage, MapReading
from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.recordings.maps.map_message import from_message, from_reading, to_message

CELLS = np.array([[FREE, OCCUPIED, UNKNOWN], [FREE, FREE, FREE]], np.int8)


def a_map(
    cells: Cells = CELLS, cell_m: float = 0.5, map_from_grid: PoseTuple = (1.0, -2.0, 0.3)
) -> GridMap:
    return GridMap(cells, cell_m, map_from_grid)


def test_a_map_cannot_be_changed() -> None:
    cells = CELLS.copy()
    grid_map = a_map(cells)
    with pytest.raises(ValueError, match="read-only"):
        grid_map.cells[0, 0] = OCCUPIED
    cells[0, 0] = OCCUPIED
    assert grid_map.cells[0, 0] == FREE
    assert (grid_map.grid.free_m2, grid_map.size_m) == (4 * 0.25, (1.5, 1.0))


def test_equal_maps_have_equal_digests() -> None:
    in_columns = np.asfortranarray(CELLS)
    assert a_map().digest == a_map(in_columns).digest == a_map(CELLS[:, :]).digest
    assert a_map(map_from_grid=(0.0, 0.0, 0.0)).digest == a_map(map_from_grid=(-0.0, 0, 0)).digest


def test_a_map_that_gives_poses_another_meaning_has_another_digest() -> None:
    others = [a_map(np.flipud(CELLS)), a_map(CELLS.reshape(3, 2)), a_map(cell_m=0.25)]
    others.append(a_map(map_from_grid=(1.0, -2.0, 0.31)))
    assert len({grid_map.digest for grid_map in (a_map(), *others)}) == 5


@pytest.mark.parametrize(("changed", "problem"), [
    ({"cells": CELLS.astype(np.int16)}, "int8"),
    ({"cells": CELLS.ravel()}, "2-d"),
    ({"cells": np.zeros((0, 3), np.int8)}, "2-d"),
    ({"cells": np.full((2, 2), 7, np.int8)}, "-1, 0 or 1"),
    ({"cells": np.full((2, 2), UNKNOWN, np.int8)}, "no cell is free"),
    *(({"cell_m": cell_m}, "cell_m") for cell_m in (0.0, -0.1, np.nan, np.inf)),
    ({"map_from_grid": (0.0, np.nan, 0.0)}, "map_from_grid"),
])  # fmt: skip
def test_an_invalid_grid_is_refused(changed: dict[str, Any], problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        a_map(**changed)


@given(
    cells=arrays(np.int8, (5, 4), elements=st.sampled_from([FREE, OCCUPIED, UNKNOWN])),
    pose=st.tuples(*[st.floats(-100, 100)] * 3),
)
def test_a_map_survives_the_wire(cells: Cells, pose: PoseTuple) -> None:
    cells[2, 2] = FREE
    sent = a_map(cells, map_from_grid=pose)
    message = to_message(sent.with_landmarks([TAG]), "bridge")
    assert message.landmarks == (TAG,)
    received = from_message(message)
    np.testing.assert_array_equal(received.cells, sent.cells)
    assert (received.cells_digest, received.map_from_grid) == (sent.digest, pose)
    assert received.landmarks == (TAG,)


TAG = Landmark(name="exit", x=1.0, y=2.0, sigma=0.1)


def test_a_changed_landmark_is_another_map_with_the_same_cells() -> None:
    bare, tagged = a_map(), a_map().with_landmarks([TAG])
    changes: list[dict[str, Any]] = [{"name": "door"}, {"x": 1.1}, {"y": 2.1}, {"sigma": 0.2}]
    others = [bare, bare.with_landmarks([TAG, TAG])]
    others += [bare.with_landmarks([replace(TAG, **change)]) for change in changes]
    assert len({tagged.digest, *(other.digest for other in others)}) == 7
    assert {other.cells_digest for other in (tagged, *others)} == {bare.digest}
    assert bare.with_landmarks([replace(TAG, x=0.0)]).digest == (
        bare.with_landmarks([replace(TAG, x=-0.0)]).digest
    )


def test_the_digest_without_landmarks_is_that_of_earlier_recordings() -> None:
    grid_map = GridMap(np.array([[0, 1], [-1, 0]], np.int8), 0.05, (1.0, 2.0, 0.5))
    assert grid_map.digest == "efbd29b66becf8a443019f1cff99b4f7a991212707004bd70cf17f63e651653b"


def a_message(**changed: object) -> MapMessage:
    sent = to_message(a_map(), "bridge")
    fields = {name: getattr(sent, name) for name in sent.__struct_fields__}
    return MapMessage(**{**fields, **changed})


@pytest.mark.parametrize("message", [
    a_message(zlib_cells=b"no zlib"),
    a_message(zlib_cells=b""),
    a_message(rows=3),
    a_message(rows=1),
    a_message(rows=0),
    a_message(cell_m=0.0),
    a_message(digest="00"),
    a_message(landmarks=(TAG,)),
])  # fmt: skip
def test_bytes_that_are_not_the_announced_map_are_refused(message: MapMessage) -> None:
    with pytest.raises(MalformedMessageError, match="not a valid map"):
        from_message(message)


READING = MapReading(
    sender="robot",
    cell_m=0.05,
    map_from_grid=(-1.0, 2.0, 0.1),
    occupancy=ArrayBlob.of(np.array([[0, 100, -1], [50, 0, 99]]), "int8"),
)


@pytest.mark.parametrize("change", [
    {"occupancy": ArrayBlob.of(np.zeros((0, 0)), "int8")},
    {"occupancy": ArrayBlob.of(np.zeros(9), "int8")},
    {"occupancy": ArrayBlob.of(np.zeros((3, 3)), "float32")},
    {"occupancy": ArrayBlob.of(np.full((3, 3), 100), "int8")},
    {"occupancy": ArrayBlob(dtype="int8", shape=(9, 9), data=b"123")},
    {"cell_m": 0.0},
    {"cell_m": math.nan},
    {"map_from_grid": (0.0, math.inf, 0.0)},
])  # fmt: skip
def test_an_invalid_reading_of_a_map_is_refused(change: dict[str, object]) -> None:
    with pytest.raises(MalformedMessageError):
        from_reading(msgspec.structs.replace(READING, **change))
