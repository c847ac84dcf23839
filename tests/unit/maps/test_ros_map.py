import gzip
import io
import lzma
from collections.abc import Callable
from pathlib import Path

import pytest
from PIL import Image

from clustermcl.filter.arrays import FREE, OCCUPIED, UNKNOWN
from clustermcl.protocol.errors import MapFileError
from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.recordings.maps.map_file import load_map
from tests.maps import header
from tests.unit.recordings import recording_or_skip

PGM = b"P5\n3 2\n255\n" + bytes([0, 205, 254, 254, 254, 0])  # the upper row first
OF_PGM = [[FREE, FREE, OCCUPIED], [OCCUPIED, UNKNOWN, FREE]]


def write_map(folder: Path, content: bytes = PGM, /, **changed: str) -> Path:
    (folder / "map.pgm").write_bytes(content)
    (folder / "map.yaml").write_text(header(**{"origin": "[-1.0, 2.0, 0.0]", **changed}))
    return folder / "map.yaml"


def png(*pixels: int | tuple[int, ...], mode: str = "L") -> bytes:
    image = Image.new(mode, (len(pixels), 1))
    for column, pixel in enumerate(pixels):
        image.putpixel((column, 0), pixel)
    packed = io.BytesIO()
    image.save(packed, "PNG")
    return packed.getvalue()


def test_the_lowest_row_of_the_image_is_row_0(tmp_path: Path) -> None:
    grid_map = load_map(write_map(tmp_path))
    assert grid_map.cells.tolist() == OF_PGM
    assert (grid_map.cell_m, grid_map.map_from_grid) == (0.05, (-1.0, 2.0, 0.0))


# Pixels that are occupied with probability 1, 0.6, 0.4 and 0.
STEPS = png(0, 102, 153, 255)
# Black and white, both opaque, then both clear, which is unknown.
SEEN = (0, 255), (255, 255), (255, 0), (0, 0)
RAW = png(0, 100, 50, 101, 205, 255)
F, X, U = FREE, OCCUPIED, UNKNOWN
TEXT = b"P2\n# made by a map saver\n3 1\n# really\n100\n0 80 100\n"


@pytest.mark.parametrize(("image", "changed", "cells"), [
    (b"P5\n2 1\n65535\n" + bytes([0xFF, 0xFF, 0, 0]), {}, [F, X]),
    (TEXT, {}, [X, U, F]),
    (STEPS, {"occupied_thresh": "0.6", "free_thresh": "0.4"}, [X, U, U, F]),
    (STEPS, {"occupied_thresh": "0.59", "free_thresh": "0.41"}, [X, X, F, F]),
    (png(205, 254), {"free_thresh": "0.196"}, [U, F]),
    (png(205, 254), {"free_thresh": "0.25"}, [F, F]),
    (png(0, 50, 128, 255), {"negate": "1"}, [F, U, U, X]),
    (png(0, 50, 128, 255), {"negate": "true"}, [F, U, U, X]),
    (png((255, 0, 0), (255, 255, 255), (200, 255, 255), mode="RGB"), {}, [X, F, F]),
    (png(*SEEN, mode="LA"), {}, [X, F, U, U]),
    (png(*[(v, v, v, a) for v, a in SEEN], mode="RGBA"), {"mode": "Trinary"}, [X, F, U, U]),
    (png((0, 255), (255, 255), (255, 254), (150, 255), mode="LA"), {"mode": "scale"}, [X, F, U, U]),
    (png(0, 89, 187, 205, 254, 255), {"mode": "scale", "free_thresh": "0", "occupied_thresh": "1"},
     [X, X, U, F, F, F]),
    (png(205, 254), {"mode": "scale", "free_thresh": "0"}, [U, F]),
    (RAW, {"mode": "raw"}, [F, X, U, U, U, U]),
    (RAW, {"mode": "raw", "negate": "1"}, [F, X, U, U, U, U]),
])  # fmt: skip
def test_pixels_become_cells_as_in_ros(
    tmp_path: Path, image: bytes, changed: dict[str, str], cells: list[int]
) -> None:
    loaded = load_map(write_map(tmp_path, image, **changed)).cells
    assert loaded.tolist() == [cells]


def test_an_origin_may_be_turned_and_the_mode_of_a_map_is_optional(tmp_path: Path) -> None:
    plain = load_map(write_map(tmp_path))
    assert load_map(write_map(tmp_path, mode="trinary")).digest == plain.digest
    other = load_map(write_map(tmp_path, origin="[1, 2, 1.57]", resolution="5e-2"))
    assert (other.map_from_grid, other.cell_m) == ((1.0, 2.0, 1.57), 0.05)


@pytest.mark.parametrize(("suffix", "compress"), [(".gz", gzip.compress), (".xz", lzma.compress)])
def test_header_and_image_may_be_compressed(
    tmp_path: Path, suffix: str, compress: Callable[[bytes], bytes]
) -> None:
    plain = write_map(tmp_path)
    packed = tmp_path / f"map.yaml{suffix}"
    packed.write_bytes(compress(plain.read_bytes()))
    image = tmp_path / "map.pgm"
    (tmp_path / f"map.pgm{suffix}").write_bytes(compress(image.read_bytes()))
    image.unlink()  # now only the packed one is there, under the name of the plain one
    assert load_map(packed).cells.tolist() == OF_PGM


def test_the_size_limit_of_pillow_does_not_apply(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 2)  # of 179 million, so that the test is short
    assert load_map(write_map(tmp_path)).cells.tolist() == OF_PGM
    assert Image.MAX_IMAGE_PIXELS == 2


@pytest.mark.parametrize(("changed", "problem"), [
    ({"image": ""}, "map.yaml:1: .*image"),
    ({"image": "other.pgm"}, "other.pgm does not exist"),
    ({"image": 300 * "x"}, "xxx: cannot be read: File name too long"),
    ({"image": "/nowhere/map.pgm"}, "map.pgm does: write 'image: map.pgm'"),
    ({"resolution": "-0.05"}, "map.yaml:2: .*resolution"),
    ({"resolution": "fine"}, "map.yaml:2: .*resolution"),
    ({"resolution": "true"}, "map.yaml:2: .*resolution"),
    ({"origin": "[0, 0]"}, "map.yaml:3: .*origin"),
    ({"origin": "[0, 0, 1" + 400 * "0" + "]"}, "map.yaml:3: .*origin"),
    ({"origin": "[0, .nan, 0]"}, "map.yaml:3: .*origin"),
    ({"origin": "[0, 0, .inf]"}, "origin"),
    ({"origin": "[1.0e+8, 0, 0]"}, "map.yaml:3: .*origin"),
    ({"negate": "2"}, "map.yaml:4: .*negate"),
    ({"occupied_thresh": "65"}, "map.yaml:5: .*occupied_thresh"),
    ({"free_thresh": "0.7"}, "free_thresh must not exceed occupied_thresh"),
    ({"mode": "colour"}, "map.yaml:7: .*mode"),
])  # fmt: skip
def test_a_wrong_key_is_named_with_its_line(
    tmp_path: Path, changed: dict[str, str], problem: str
) -> None:
    path = write_map(tmp_path, **changed)
    with pytest.raises(MapFileError, match=problem) as caught:
        load_map(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("image", "changed", "remark"), [
    (PGM, {"free_thresh": "0.25"}, "17% of the pixels are grey 205"),
    (PGM, {"origin": "[0, 0, -nan]"}, "its yaw is not a number and is taken as 0"),
    (PGM, {"origin": "[0, 0, .nan]"}, "its yaw is not a number and is taken as 0"),
    (PGM, {}, None),
])  # fmt: skip
def test_what_is_odd_in_a_map_is_a_remark(
    tmp_path: Path, image: bytes, changed: dict[str, str], remark: str | None
) -> None:
    grid_map = load_map(write_map(tmp_path, image, **changed))
    assert [remark in each for each in grid_map.remarks if remark] == ([True] if remark else [])
    assert len(grid_map.remarks) == (remark is not None)
    assert grid_map.map_from_grid[2] == 0.0


@pytest.mark.parametrize(("text", "problem"), [
    ("", "empty"),
    ("- image\n- resolution\n", "not a file of map_server"),
    ("image: map.pgm\nresolution: [1\n", "map.yaml:3: not YAML"),
    ("image: \x00", "not YAML"),
    ("a: !!timestamp x", "not YAML"),
    (f"a: 1{':1' * 400}.5", "not YAML"),
    ("a: !!python/object:os.system x", "map.yaml:1: not YAML: could not determine"),
])  # fmt: skip
def test_a_header_that_is_not_a_mapping_is_refused(tmp_path: Path, text: str, problem: str) -> None:
    (tmp_path / "map.yaml").write_text(text)
    with pytest.raises(MapFileError, match=problem):
        load_map(tmp_path / "map.yaml")


@pytest.mark.parametrize(("image", "problem"), [
    (PGM[:-1], "cut off or damaged"),
    (b"P2\n3 2\n255\n0 205", "cut off or damaged"),
    (png(*range(256))[:45], "cut off or damaged"),
    (b"P5\n3", "damaged"),
    (b"", "not an image"),
    (b"<html>not found</html>", "not an image"),
    (b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 2 1\n%%EndComments\n", "not an image"),
    (b"version https://git-lfs.github.com/spec/v1\noid sha256:4d\n", "run 'git lfs pull'"),
    (b"P5\n40000 40000\n255\n", "at most 268435456"),
    (b"P5\n2 1\n255\n\x00\xcd", "no free space"),
])  # fmt: skip
def test_an_image_that_is_not_a_map_is_refused(tmp_path: Path, image: bytes, problem: str) -> None:
    path = write_map(tmp_path, image)
    with pytest.raises(MapFileError, match=problem) as caught:
        load_map(path)
    assert caught.value.path == tmp_path / "map.pgm"


@pytest.mark.parametrize(("name", "shape", "free_m2"), [
    ("carmen-maps/nsh_level_3", (469, 677), 618.4),
    ("ros-maps/turtlebot3_world", (384, 384), 19.8),
    ("ros-maps/depot", (307, 604), 448.7),
    ("ros-maps/warehouse", (1674, 1006), 1280.1),
])  # fmt: skip
def test_published_maps_of_other_projects_are_read(
    name: str, shape: tuple[int, int], free_m2: float
) -> None:
    grid_map: GridMap = load_map(recording_or_skip(f"{name}.yaml"))
    assert grid_map.cells.shape == shape
    assert grid_map.grid.free_m2 == pytest.approx(free_m2, abs=0.1)
