"""The whole stack, started and ended at random moments: nothing hangs, nothing is left."""

import os
import random
import signal
import sys
import tempfile
import time
from pathlib import Path

import psutil
import pytest

from tests.integration.system.commands import typed
from tests.integration.waiting import wait_until

SMALL = (
    "bridge.source=sim:cross",
    "worker.count=2",
    "cluster.particles=300",
    "search.poses=4000",
    "belief.max_clusters=4",
)
END_WITHIN_S = 3.0
CLEAN_CODES = {0, 130, 143, -signal.SIGINT, -signal.SIGTERM}
"""Exit code after SIGINT, as a shell reports it and as `subprocess` reports it."""
OURS = "clustermcl"
"""Output without it comes from the interpreter, before our first line ran."""


def assert_ends_cleanly(seed: int, cache: Path) -> None:
    """Start the whole stack; end it at a moment and in a way that the seed decides.

    Half of the moments are while it starts: imports, kernels, connections; half while it works.
    """
    rng = random.Random(seed)
    after_s = rng.uniform(0.05, 2.0) if rng.random() < 0.5 else rng.uniform(2.0, 7.0)
    number = rng.choice([signal.SIGINT, signal.SIGTERM])
    times = 2 if rng.random() < 0.2 else 1
    sys.stderr.write(f"{number.name} {times} times after {after_s:.2f} s\n")  # shown if it fails
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background ignores it
    shared_before = shared_memory()
    with tempfile.TemporaryDirectory(prefix="mcl-") as name:
        folder, own = Path(name), Path(name) / "tmp"
        own.mkdir()
        settings = (
            *SMALL,
            f"worker.cache_folder={cache}",
            f"zenoh.router=unixsock-stream/{name}/r",
        )
        words = [word for setting in settings for word in ("--set", setting)]
        environment = {**os.environ, "TMPDIR": str(own), "XDG_STATE_HOME": f"{name}/state"}
        with typed("up", *words, folder=folder, environment=environment) as up:
            time.sleep(after_s)  # the random moment itself
            up.meet_family()  # what is left of it is killed
            for _ in range(times):
                up.send_signal(number)
            wait_until(lambda: not up.is_running() and not members(up.pid), END_WITHIN_S)
            assert up.wait() in CLEAN_CODES
            printed = up.out + up.err
        assert not ("Traceback" in printed and OURS in printed), printed
        assert "Timeout (" not in printed, printed
        assert list(own.iterdir()) == [], "left in the temporary folder"
    assert shared_memory() <= shared_before, "left in /dev/shm"


def members(session: int) -> list[psutil.Process]:
    """All processes of a session but zombies: the first one, its children and theirs."""
    found = []
    for process in psutil.process_iter():
        try:
            if os.getsid(process.pid) == session and process.status() != psutil.STATUS_ZOMBIE:
                found.append(process)
        except (ProcessLookupError, psutil.NoSuchProcess):
            continue
    return found


def shared_memory() -> set[str]:
    """Names in /dev/shm; those of multiprocessing belong to others, nothing here uses it."""
    folder = Path("/dev/shm")
    if not folder.is_dir():
        return set()
    return {file.name for file in folder.iterdir() if not file.name.startswith("sem.mp-")}


@pytest.mark.parametrize("seed", [0, 1, 4, 7])  # both signals, once and twice, early and late
def test_a_stack_ended_at_any_moment_ends_cleanly_within_three_seconds(
    seed: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    assert_ends_cleanly(seed, tmp_path_factory.getbasetemp() / "likelihood-fields")


@pytest.mark.soak
@pytest.mark.timeout(3600)
def test_two_hundred_cycles_of_start_and_stop_end_cleanly(tmp_path: Path) -> None:
    for seed in range(1000, 1200):
        assert_ends_cleanly(seed, tmp_path)
