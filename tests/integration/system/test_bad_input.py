import subprocess
from pathlib import Path

import psutil

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


def test_a_demo_without_a_map_or_in_a_map_without_room_is_refused(tmp_path: Path) -> None:
    assert_refused(ran("demo", "--map", str(tmp_path / "no.yaml")), "no.yaml")
    narrow = write_room(tmp_path, cells=(6, 62))
    assert_refused(ran("demo", "--map", str(narrow)), "0.6 m wide")


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
