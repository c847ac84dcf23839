import subprocess
from pathlib import Path

import psutil

from tests.integration.system.commands import ran
from tests.integration.worlds import write_room


def assert_refused(done: subprocess.CompletedProcess[str], *facts: str) -> None:
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr
    assert done.stderr.count("\n") == 1, done.stderr
    assert done.stdout == ""
    for fact in facts:
        assert fact in done.stderr
    running = [child.cmdline() for child in psutil.Process().children(recursive=True)]
    assert not [words for words in running if "-m" in words], "a process was left"


def test_a_demo_without_a_map_or_in_a_map_without_room_is_refused(tmp_path: Path) -> None:
    assert_refused(ran("demo", "--map", str(tmp_path / "no.yaml")), "no.yaml")
    narrow = write_room(tmp_path, cells=(6, 62))
    assert_refused(ran("demo", "--map", str(narrow)), "0.6 m wide")
