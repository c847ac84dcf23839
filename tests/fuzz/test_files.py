import contextlib
import io
from pathlib import Path

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from clustermcl.evaluation.references import load_reference
from clustermcl.protocol.errors import (
    InputFileError,
    LandmarksFileError,
    MapFileError,
    RecordingError,
    ReferenceFileError,
    SettingsError,
)
from clustermcl.recordings.maps.landmarks import load_landmarks
from clustermcl.recordings.maps.map_file import load_map
from clustermcl.recordings.recording import open_recording
from clustermcl.runtime.settings import BridgeSettings, Settings
from clustermcl.runtime.settings_file import load_settings
from clustermcl.runtime.settings_table import TABLE, settings_as_toml
from clustermcl.sensor_bridge.recorded import steps_of
from tests.fuzz.effort import cases
from tests.fuzz.mutations import damaged, packed
from tests.maps import HEADER, header
from tests.unit.recordings.logs import flaser, odom, robot_laser

NUMBERS = st.sampled_from(
    ["0", "1", "-1", "3", "2.5", "180", "-0.0", "1e9", "1e400", "-1e308", "nan", "inf", "1_0",
     "0x10", "1e-320", "99999999999999999999", "", "x", "\0", "٣"]
)  # fmt: skip
WORDS = NUMBERS | st.sampled_from(
    ["ODOM", "FLASER", "PARAM", "ROBOTLASER1", "O", "L", "#", "SYNC", "host",
     "robot_frontlaser_offset"]
)  # fmt: skip


def lines(*strategies: st.SearchStrategy[str]) -> st.SearchStrategy[bytes]:
    listed = st.lists(st.one_of(strategies), max_size=12)
    return listed.map(lambda text: "\n".join(text).encode())


stamps = st.floats(0.0, 20.0).map("{:.3f}".format) | NUMBERS
poses = st.tuples(*[st.floats(-5.0, 5.0).map("{:.3f}".format) | NUMBERS] * 3)
ranges = st.lists(st.floats(0.1, 80.0).map("{:.2f}".format) | NUMBERS, max_size=8)
junk_lines = st.lists(WORDS, max_size=14).map(" ".join)
carmen_logs = lines(
    st.builds(odom, stamps, poses),
    st.builds(flaser, stamps, poses, ranges),
    st.builds(robot_laser, stamps, ranges, poses, poses),
    junk_lines,
)


@cases(0.06)
@given(packed(damaged(carmen_logs)))
def test_a_recording_becomes_steps_or_is_refused(folder: Path, content: bytes) -> None:
    path = folder / "recording.log"
    path.write_bytes(content)
    with contextlib.suppress(RecordingError):
        recording = open_recording(path, BridgeSettings())
        for step in steps_of(recording, BridgeSettings(), map_digest=""):
            assert np.all(np.isfinite(step.odom_from_robot))


@cases(0.04)
@given(packed(damaged(lines(st.lists(NUMBERS, min_size=7, max_size=9).map(" ".join), junk_lines))))
def test_a_reference_is_read_or_refused(folder: Path, content: bytes) -> None:
    path = folder / "reference.tum"
    path.write_bytes(content)
    with contextlib.suppress(ReferenceFileError):
        load_reference(path).pose_at(0)


def image(mode: str, kind: str, side: int) -> bytes:
    packed_image = io.BytesIO()
    Image.new(mode, (side, side + 1), 254 if mode in ("1", "L") else None).save(packed_image, kind)
    return packed_image.getvalue()


images = st.one_of(
    st.builds(image, st.sampled_from(["1", "L", "LA", "RGB", "RGBA", "P", "I;16"]), st.just("PNG"),
              st.integers(1, 40)),
    st.builds(image, st.sampled_from(["1", "L", "RGB"]), st.just("PPM"), st.integers(1, 40)),
    st.builds(lambda w, h, rest: f"P5\n{w} {h}\n255\n".encode() + rest, NUMBERS, NUMBERS,
              st.binary(max_size=40)),
)  # fmt: skip
yaml_values = NUMBERS | st.sampled_from(
    ["[0, 0, 0]", "[a, b]", "{a: b}", "&a [*a]", "*a", "!!python/object:os.system x", "map.pgm",
     "[[[[", "2001-99-99", "0.05", "scale", "raw", "? ", "!!binary x", "<<: {a: 1}", "'", "../.."]
)  # fmt: skip
headers = st.dictionaries(st.sampled_from([*HEADER, "mode", "<<"]), yaml_values, max_size=2).map(
    lambda changes: header(**changes).encode()
)


@cases(0.05)
@given(damaged(headers), packed(images))
def test_a_ros_map_is_read_or_refused(folder: Path, text: bytes, pixels: bytes) -> None:
    (folder / "map.yaml").write_bytes(text)
    (folder / "map.pgm").write_bytes(pixels)
    with contextlib.suppress(MapFileError):
        load_map(folder / "map.yaml")


building_values = yaml_values | st.sampled_from(
    ["map.yaml", "/dev/null", "building.yaml", "{map: map.yaml, height_m: 3}", "[1, 2]",
     "{a: [0, 0], b: [0, 0]}", "package://p/map.yaml", "package://../../map.yaml"]
)  # fmt: skip
LINKS = "links: [{{name: x, at: {{a: {}, b: {}}}, radius_m: {}}}]"
LEVELS = "maps: {{a: {{yaml: {}, origin: {}}}, b: {}}}\nlinks: [{{from_point: {}}}]"
buildings = st.builds(
    f"floors: {{{{a: {{}}, b: {{}}, {{}}: {{}}}}}}\n{LINKS}".format, *[building_values] * 7
) | st.builds(LEVELS.format, *[building_values] * 4)


@cases(0.05)
@given(damaged(buildings.map(str.encode)))
def test_a_building_is_read_or_refused(folder: Path, text: bytes) -> None:
    (folder / "map.yaml").write_text(header())
    (folder / "map.pgm").write_bytes(b"P5\n3 2\n255\n" + bytes([0, 205, 254, 254, 254, 0]))
    (folder / "building.yaml").write_bytes(text)
    with contextlib.suppress(MapFileError):
        floors = load_map(folder / "building.yaml").floors
        for name in floors.names:
            assert floors.on_floor(floors.in_atlas(name, (0.0, 0.0, 0.0)))[0] in floors.names


LANDMARKS = b"landmarks: [{id: a, x: 1, y: -2}, {class: b, x: 0, y: 0, sigma: 0.1}]"


@cases(0.03)
@given(packed(damaged(st.just(LANDMARKS))))
def test_landmarks_are_read_or_refused(folder: Path, text: bytes) -> None:
    (folder / "landmarks.yaml").write_bytes(text)
    with contextlib.suppress(LandmarksFileError):
        load_landmarks(folder / "landmarks.yaml")


toml_values = NUMBERS | st.sampled_from(
    ["true", '"x"', "[1]", "{a=1}", "[" * 3000, "{a=" * 3000, "9" * 5000, "1979-05-27", "''", "0.5"]
)
settings_files = lines(
    st.sampled_from(sorted({f"[{name.partition('.')[0]}]" for name in TABLE})),
    st.builds(
        "{} = {}".format, st.sampled_from([n.rpartition(".")[2] for n in TABLE]), toml_values
    ),
    junk_lines,
) | st.just(settings_as_toml(Settings()).encode())


@cases(0.05)
@given(damaged(settings_files), st.lists(st.builds("{}={}".format, st.sampled_from(list(TABLE)),
       toml_values), max_size=2))  # fmt: skip
def test_settings_are_read_or_refused(folder: Path, content: bytes, given_too: list[str]) -> None:
    path = folder / "settings.toml"
    path.write_bytes(content)
    with contextlib.suppress(InputFileError, SettingsError):
        load_settings(path, given_too)
