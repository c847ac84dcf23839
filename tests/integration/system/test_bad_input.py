import subprocess
from pathlib import Path

import numpy as np
import psutil
import pytest
from PIL import Image

from tests.integration.system.commands import COMMAND, ran
from tests.integration.waiting import stretched_s
from tests.integration.worlds import write_room

NO_ROUTER = "zenoh.router=unixsock-stream//tmp/clustermcl-nobody-listens-here"


def assert_refused(done: subprocess.CompletedProcess[str], *facts: str, code: int = 2) -> None:
    assert done.returncode == code, done.stderr
    assert "Traceback" not in done.stderr
    assert done.stderr.count("\n") == 1, done.stderr
    assert done.stdout == ""
    for fact in facts:
        assert fact in done.stderr
    running = [child.cmdline() for child in psutil.Process().children(recursive=True)]
    assert not [words for words in running if "-m" in words], "a process was left"


@pytest.fixture
def map_file(tmp_path: Path) -> Path:
    return write_room(tmp_path, cells=(60, 80))


def written_map(folder: Path, cells: np.ndarray) -> Path:
    Image.fromarray(cells).save(folder / "map.pgm")
    yaml = folder / "map.yaml"
    yaml.write_text(
        "image: map.pgm\nresolution: 0.1\norigin: [0, 0, 0]\nnegate: 0\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    return yaml


def log_of(folder: Path, *ranges: str) -> Path:
    path = folder / "log.clf"
    lines = [
        f"FLASER 3 {values} {i}.0 0 0 {i}.0 0 0 {i}.5 host {i}.5" for i, values in enumerate(ranges)
    ]
    path.write_text("\n".join(lines) + "\n")
    return path


def test_a_demo_without_a_map_or_in_a_map_without_room_is_refused(tmp_path: Path) -> None:
    assert_refused(ran("demo", "--map", str(tmp_path / "no.yaml")), "no.yaml")
    for cells, fact in (
        (np.full((60, 60), 205, np.uint8), "no free space"),
        (np.full((60, 60), 254, np.uint8), "no obstacle"),
        (np.pad(np.full((4, 60), 254, np.uint8), 8), "0.6 m wide"),
    ):
        assert_refused(ran("demo", "--map", str(written_map(tmp_path, cells))), fact)


def test_recordings_without_a_usable_scan_are_refused(tmp_path: Path, map_file: Path) -> None:
    no_beams, cut = tmp_path / "beams.clf", tmp_path / "cut.log.xz"
    no_beams.write_text("FLASER 0 0 0 0 0 0 0 1.0 host 1.0\n")
    cut.write_bytes(b"\xfd7zXZ\x00\x00\x04")
    no_returns = log_of(tmp_path, "nan nan nan", "0 0 0", "inf -1 nan")
    for log in (tmp_path / "nowhere.log", no_beams, cut, no_returns):
        assert_refused(ran("evaluate", str(log), "--map", str(map_file)), log.name)


@pytest.mark.parametrize(
    ("words", "facts"),
    [
        ("settings --set cluster.particels=5", ("cluster.particels", "cluster.particles")),
        ("settings --set cluster.particles=many", ("cluster.particles",)),
        ("demo --recording sim:atlantis", ("atlantis", "cross")),
        ("demo --recording zenoh", ("--recording", "clustermcl up")),
    ],
    ids=["unknown setting", "setting of the wrong type", "unknown world", "demo of a live robot"],
)
def test_a_command_with_a_mistake_names_what_is_meant(words: str, facts: tuple[str, ...]) -> None:
    assert_refused(ran(*words.split()), *facts)


def test_without_a_system_all_queries_fail_within_three_seconds() -> None:
    queries = [
        subprocess.Popen(
            [*COMMAND, command, "--set", NO_ROUTER],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )
        for command in ("pose", "hypotheses", "status", "watch", "relocalize")
    ]  # fmt: skip
    ended = [(query, query.communicate(timeout=stretched_s(5.0))) for query in queries]
    for query, (out, err) in ended:
        done = subprocess.CompletedProcess(query.args, query.returncode, out, err)
        assert_refused(done, "no router", "clustermcl up", code=3)
