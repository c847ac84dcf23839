import zlib

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from clustermcl.protocol.errors import MalformedMessageError
from clustermcl.protocol.steps import MapMessage
from clustermcl.view import frames
from clustermcl.view.frames import reduced
from tests.unit.view.messages import map_message


@pytest.fixture(autouse=True)
def small_screen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(frames, "MAX_SIDE", 4)


def message(cells: NDArray[np.int8]) -> MapMessage:
    rows, cols = cells.shape
    packed = zlib.compress(cells.tobytes())
    return msgspec.structs.replace(map_message(), rows=rows, cols=cols, zlib_cells=packed)


def cells_of(made: MapMessage) -> NDArray[np.int8]:
    cells = np.frombuffer(zlib.decompress(made.zlib_cells), np.int8)
    return cells.reshape(made.rows, made.cols)


def test_a_small_map_is_not_reduced() -> None:
    made = message(np.zeros((4, 3), np.int8))
    assert reduced(made) is made


def test_in_a_reduced_block_a_wall_wins_before_a_free_cell_and_the_rim_is_kept() -> None:
    cells = np.full((6, 8), -1, np.int8)
    cells[0:2, 0:2] = [[0, 0], [0, 1]]
    cells[2, 2] = 0
    made = reduced(message(cells))
    assert (made.rows, made.cols, made.cell_m) == (3, 4, 1.0)
    assert cells_of(made).tolist() == [[1, -1, -1, -1], [-1, 0, -1, -1], [-1, -1, -1, -1]]
    cells = np.zeros((7, 5), np.int8)
    cells[6, 4] = 1
    made = reduced(message(cells))
    assert (made.rows, made.cols) == (4, 3)
    assert cells_of(made)[3].tolist() == [0, 0, 1]


@pytest.mark.parametrize("packed", [b"rubbish", zlib.compress(b"\0" * 30)])
def test_damaged_or_too_few_map_bytes_are_refused(packed: bytes) -> None:
    made = message(np.zeros((8, 8), np.int8))
    with pytest.raises(MalformedMessageError, match="map"):
        reduced(msgspec.structs.replace(made, zlib_cells=packed))
