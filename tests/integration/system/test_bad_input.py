import subprocess
from pathlib import Path

import numpy as np
import psutil
import pytest
from PIL import Image

from tests.integration.system.commands import COMMAND, ran
from tests.integration.waiting import stretched_s

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


def written_map(folder: Path, cells: np.ndarray) -> Path:
    Image.fromarray(cells).save(folder / "map.pgm")
    yaml = folder / "map.yaml"
    yaml.write_text(
        "image: map.pgm\nresolution: 0.1\norigin: [0, 0, 0]\nnegate: 0\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    return yaml


def test_a_demo_without_a_map_or_in_a_map_without_room_is_refused(tmp_path: Path) -> None:
    assert_refused(ran("demo", "--map", str(tmp_path / "no.yaml")), "no.yaml")
    narrow = written_map(tmp_path, np.pad(np.full((4, 60), 254, np.uint8), 8))
    assert_refused(ran("demo", "--map", str(narrow)), "0.6 m wide")


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
