import math

import msgspec
import numpy as np
import pytest

from grid_maps.map_message import from_reading
from particle_filter.arrays import FREE, OCCUPIED, UNKNOWN
from protocol.arrays import ArrayBlob
from protocol.codec import decode, encode
from protocol.errors import MalformedMessageError
from protocol.steps import MapReading

READING = MapReading(
    sender="robot",
    cell_m=0.05,
    map_from_grid=(-1.0, 2.0, 0.1),
    occupancy=ArrayBlob.of(np.array([[0, 100, -1], [50, 0, 99]]), "int8"),
)


def test_occupancy_is_read_as_amcl_does() -> None:
    grid_map = from_reading(decode(encode(READING), MapReading))
    assert grid_map.cells.tolist() == [[FREE, OCCUPIED, UNKNOWN], [UNKNOWN, FREE, UNKNOWN]]
    assert (grid_map.cell_m, grid_map.map_from_grid) == (0.05, (-1.0, 2.0, 0.1))


@pytest.mark.parametrize(
    "change",
    [
        {"occupancy": ArrayBlob.of(np.zeros((0, 0)), "int8")},
        {"occupancy": ArrayBlob.of(np.zeros(9), "int8")},
        {"occupancy": ArrayBlob.of(np.zeros((3, 3)), "float32")},
        {"occupancy": ArrayBlob.of(np.full((3, 3), 100), "int8")},
        {"occupancy": ArrayBlob(dtype="int8", shape=(9, 9), data=b"123")},
        {"cell_m": 0.0},
        {"cell_m": math.nan},
        {"map_from_grid": (0.0, math.inf, 0.0)},
    ],
)
def test_what_is_no_map_is_refused(change: dict[str, object]) -> None:
    with pytest.raises(MalformedMessageError):
        from_reading(msgspec.structs.replace(READING, **change))
