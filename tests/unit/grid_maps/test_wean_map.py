import gzip
import subprocess
import sys
from pathlib import Path

import pytest

from particle_filter.arrays import FREE, OCCUPIED, UNKNOWN
from protocol.errors import MapFileError
from recordings.map_file import load_map
from tests.unit.recordings import recording_or_skip

HEADER = "robot_specifications->global_mapsize_x   30\nrobot_specifications->resolution   10\n\n"
GRID = "global_map[0]: 3 2\n1.0 0.9\n-1.000 0.000\n0.5 0.35\n"  # one line for each x


def write_map(folder: Path, text: str) -> Path:
    (folder / "wean.dat").write_text(text)
    return folder / "wean.dat"


def test_the_first_index_is_x_and_numbers_are_free_probabilities(tmp_path: Path) -> None:
    grid_map = load_map(write_map(tmp_path, HEADER + GRID))
    lowest_y, highest_y = [FREE, UNKNOWN, UNKNOWN], [FREE, OCCUPIED, UNKNOWN]
    assert grid_map.cells.tolist() == [lowest_y, highest_y]
    assert (grid_map.cell_m, grid_map.map_from_grid) == (0.1, (0.0, 0.0, 0.0))


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (HEADER, ":3: cut off: no line 'global_map"),
        (GRID, ":1: no robot_specifications->resolution"),
        (HEADER.replace("10", "ten") + GRID, ":2: the resolution is not a number"),
        (HEADER.replace("10", "-10") + GRID, ":2: resolution -10.0 cm: must be positive"),
        (HEADER + "global_map[0]: 3\n", ":4: global_map[0]: needs two whole numbers"),
        (HEADER + "global_map[0]: 3 -2\n", ":4: 3 x -2 cells"),
        (HEADER + GRID[:27], ":5: cut off: 1 of 3 lines"),
        (HEADER + GRID[:-6], ":7: 1 numbers, expected 2; the file may be cut off"),
        (HEADER + GRID.replace("0.9", ""), ":5: 1 numbers, expected 2"),
        (HEADER + GRID.replace("0.9", "0.9 0.9"), ":5: 3 numbers, expected 2"),
        (HEADER + GRID.replace("0.9", "x"), ":5: could not convert string to float: 'x'"),
        (HEADER + GRID.replace("0.9", "9.0"), ":5: a number is neither -1"),
        (HEADER + GRID.replace("0.9", "nan"), ":5: a number is neither -1"),
        (HEADER + GRID.replace("0.9", "0.8").replace("1.0 ", "0.7 "), "no free space"),
    ],
)
def test_a_broken_map_is_refused_with_the_line(tmp_path: Path, text: str, problem: str) -> None:
    with pytest.raises(MapFileError) as caught:
        load_map(write_map(tmp_path, text))
    assert problem in str(caught.value)


def test_the_map_may_be_compressed(tmp_path: Path) -> None:
    plain = write_map(tmp_path, HEADER + GRID)
    packed = tmp_path / "packed"
    packed.write_bytes(gzip.compress(plain.read_bytes()))
    assert load_map(packed).digest == load_map(plain).digest


def test_both_files_of_wean_hall_are_the_same_map() -> None:
    text = load_map(recording_or_skip("wean/wean.dat.xz"))
    image = load_map(recording_or_skip("wean/map.yaml"))
    assert text.digest == image.digest
    assert text.cells.shape == (800, 800)
    assert text.free_area_m2 == pytest.approx(485, abs=1)


def test_reading_a_map_imports_no_mathematics_and_only_its_own_format(tmp_path: Path) -> None:
    path = write_map(tmp_path, HEADER + GRID)
    program = (
        "import sys; from recordings.map_file import load_map; load_map(sys.argv[1]);"
        "print(sorted({'numba', 'scipy', 'yaml', 'PIL'} & set(sys.modules)))"
    )
    command = [sys.executable, "-c", program, str(path)]
    printed = subprocess.run(command, capture_output=True, text=True, check=True)
    assert printed.stdout.strip() == "[]"
