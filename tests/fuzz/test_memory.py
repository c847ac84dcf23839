"""No small file takes a gigabyte or a minute, whatever it unpacks to.

Each file is written and read in processes of their own, of which the system measures the second.
"""

import gzip
import lzma
import multiprocessing
import os
import resource
from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path

import msgspec
import numpy as np
import pytest
from backports import zstd
from PIL import Image

from clustermcl import load_landmarks
from clustermcl.coordinator.recorder.replay import replayed
from clustermcl.coordinator.recorder.ring import EVENTS, HEAD
from clustermcl.evaluation.references import load_reference
from clustermcl.protocol.errors import ClusterMclError
from clustermcl.protocol.steps import MAX_BEAMS
from clustermcl.recordings import foxglove
from clustermcl.recordings.maps.map_file import load_map
from clustermcl.recordings.recording import open_recording
from clustermcl.recordings.run_log import BELIEF, GRID, ODOMETRY, PROFILE, SCAN
from clustermcl.ros2.nav2_params import read_nav2_params
from clustermcl.runtime.settings import BridgeSettings
from clustermcl.runtime.settings_file import load_settings
from clustermcl.sensor_bridge.recorded import steps_of
from clustermcl.view.recorded_run import RecordedRun
from tests.maps import header
from tests.unit.recordings import bags
from tests.unit.recordings.bombs import channel, chunk, mcap, record
from tests.unit.recordings.logs import flaser, odom
from tests.unit.view.messages import belief, scan

SMALL_BYTES = 2**20
MOST_MB, MOST_S = 950, 40
"""Memory with that of the libraries (150 MB), and processor time."""

Write = Callable[[Path], object]
Message = tuple[str, bytes]


# --- files that unpack to far more than their size ------------------------------------------------


def records(*content: bytes) -> Write:
    return lambda path: path.write_bytes(mcap(PROFILE, *content))


def messages(contents: Iterable[Message], times: int = 1, chunks: int = 1) -> Write:
    """A run log with chunks that repeat messages, which are given by topic and content."""

    def write(path: Path) -> None:
        found = list(contents)
        number = {topic: at for at, topic in enumerate(dict.fromkeys(topic for topic, _ in found))}
        content = b"".join(
            record(5, number[topic].to_bytes(2, "little") + bytes(20) + data)
            for topic, data in found
        )
        channels = [channel(topic, at) for topic, at in number.items()]
        path.write_bytes(mcap(PROFILE, *channels, *[chunk(content * times)] * chunks))

    return write


def scan_of(beams: int, step: int = 0) -> Message:
    made = foxglove.laser_scan(scan(step, [1.0]), scan(step, [1.0]))
    made |= {"ranges": [], "angle_step_rad": 6.0 / beams, "stamp_ns": step * 10**8}
    packed = msgspec.json.encode(made)
    return SCAN, packed.replace(b'"ranges":[]', b'"ranges":[' + b"1," * (beams - 1) + b"1]")


def steps(count: int) -> Iterable[Message]:
    for step in range(count):
        yield scan_of(360, step)
        yield BELIEF, msgspec.json.encode(belief(step, 4))


def link() -> Message:
    return ODOMETRY, msgspec.json.encode(foxglove.LinkFields(0, foxglove.BASE, (0.0, 0.0, 0.0)))


def grid(cells: int) -> Message:
    return GRID, msgspec.json.encode(foxglove.MapFields(1.0, (0.0, 0.0, 0.0), 2, bytes(cells)))


def hole(path: Path) -> None:
    path.write_bytes(mcap(PROFILE)[:-50] + b"\x09" + (2**30).to_bytes(8, "little"))
    os.truncate(path, 2**31)


def bag(form: str) -> Write:
    sent = (bags.scan(at, np.zeros(5_000_000)) for at in range(1, 10))
    return lambda path: bags.written(path.parent, form, sent).rename(path)


PACKERS: dict[str, Callable[[bytes], bytes]] = {
    "gz": partial(gzip.compress, compresslevel=6),
    "xz": partial(lzma.compress, preset=0),
    "zstd": partial(zstd.compress, level=1),
}


def packed(pack: str, first: str, line: str, size: int = 2**27) -> Write:
    text, more = f"{first}\n".encode(), f"{line}\n".encode()
    return lambda path: path.write_bytes(PACKERS[pack](text + more * (size // len(more))))


def text(line: str, size: int) -> Write:
    return lambda path: path.write_text(line * (size // len(line)))


def image(kind: str) -> Write:
    def write(path: Path) -> None:
        Image.new("L", (2**14, 2**14), 254).save(path.parent / f"map.{kind}")
        path.write_text(header(image=f"map.{kind}"))

    return write


# --- what reads them ------------------------------------------------------------------------------


def localize(path: Path) -> None:
    for _ in steps_of(open_recording(path, BridgeSettings()), BridgeSettings(), ""):
        pass


def view(path: Path) -> None:
    RecordedRun(path).saved()


def replay(path: Path) -> None:
    for _ in replayed(path.parent, "1"):
        pass


PACKED = [form for form in bags.FORMS if {"bz2", "lz4", "zstd"} & {*form.split()}]
CASES: dict[str, tuple[Write, Callable[[Path], object]]] = {
    "scans of 8 million beams": (messages([scan_of(8_000_000)], 1, 16), localize),
    "scans of 8 million beams on the page": (messages([scan_of(8_000_000)], 1, 16), view),
    "scans": (messages(map(scan_of, [MAX_BEAMS] * 99, range(99)), 10, 60), localize),
    "scans on the page": (messages([scan_of(MAX_BEAMS)], 900, 60), view),
    "steps on the page": (messages(steps(900), 1, 60), view),
    "odometry": (messages([link()], 400_000, 40), localize),
    "maps": (messages([grid(2**22)], 6, 60), load_map),
    "maps on the page": (messages([grid(2**22)], 6, 60), view),
    "topics": (records(chunk(channel("/a") * 1_000_000)), localize),
    "records": (records(channel("/a"), *[chunk(record(5, bytes(22)) * 2_000_000)] * 40), localize),
    "a hole": (hole, localize),
    "flight recording": (
        messages([(HEAD, b"\x82\xa7version\xa11\xa1e\xdd\x01\0\0\0" + b"\x90" * 2**24)]),
        replay,
    ),
    "events": (messages([(HEAD, b""), (EVENTS, b"\xdd\x01\0\0\0" + b"\x90" * 2**24)]), replay),
    **{f"bag: {form}": (bag(form), localize) for form in PACKED},
    "odometry in lines": (packed("gz", "", odom(0), 2**28), localize),
    "beams": (packed("gz", "", flaser(0, ranges=(0,) * 300_000)), localize),
    "bad lines": (packed("zstd", odom(0), "x"), localize),
    "empty lines": (packed("zstd", odom(0), ""), localize),
    "reference": (packed("zstd", "", "0 0 0 0 0 0 0 1"), load_reference),
    "map: png": (image("png"), load_map),
    "map header": (packed("xz", "image: map.pgm", "a: b"), load_map),
    "landmarks": (packed("xz", "landmarks:", "- {id: a, x: 1, y: 2}"), load_landmarks),
    "a megabyte of landmarks": (text("[", SMALL_BYTES), load_landmarks),
    "other landmarks": (text("- {id: a, x: 1, y: 2}\n", SMALL_BYTES), load_landmarks),
    "nav2's parameters": (text("a: {b: [1, 2]}\n", 2**18), read_nav2_params),
    "settings": (text("a.b.c = 1\n", 2**18), lambda path: load_settings(path, ())),
}  # fmt: skip


def measured(name: str, path: Path, *, writes: bool, results: Connection) -> None:
    """Write or read a case in this process; send what it used."""
    resource.setrlimit(resource.RLIMIT_CPU, (3 * MOST_S, 3 * MOST_S))
    resource.setrlimit(resource.RLIMIT_AS, (2**33, 2**33))
    with suppress(ClusterMclError):
        CASES[name][not writes](path)
    results.send(resource.getrusage(resource.RUSAGE_SELF))


def used_in_child(name: str, path: Path, *, writes: bool) -> resource.struct_rusage:
    """Use a process that has imported all readers, and nothing else."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([__name__])
    results, of_child = context.Pipe(duplex=False)
    how = {"writes": writes, "results": of_child}
    child = context.Process(target=measured, args=(name, path), kwargs=how)
    child.start()
    of_child.close()
    try:
        used: resource.struct_rusage = results.recv()
    finally:
        child.join()
    return used


@pytest.mark.parametrize("name", CASES)
def test_a_small_file_takes_neither_a_gigabyte_nor_a_minute(tmp_path: Path, name: str) -> None:
    path = tmp_path / f"{7:017d}-000001.mcap"
    used_in_child(name, path, writes=True)
    assert max(file.stat().st_blocks * 512 for file in tmp_path.rglob("*")) <= SMALL_BYTES
    used = used_in_child(name, path, writes=False)
    assert used.ru_maxrss / 1024 <= MOST_MB
    assert used.ru_utime + used.ru_stime <= MOST_S
