"""The whole stack, started and ended at random moments: nothing hangs, nothing is left."""

import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import psutil
import pytest

if sys.platform != "linux":
    pytest.skip("only Linux ends children with their parent", allow_module_level=True)

COMMAND = [sys.executable, "-I", "-m", "clustermcl", "up"]
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
_LOST_AFTER_S = 20.0


@dataclass(frozen=True)
class Moment:
    """When a stack is ended, and how."""

    after_s: float
    number: signal.Signals
    twice: bool

    def __str__(self) -> str:
        times = " twice" if self.twice else ""
        return f"{self.number.name}{times} after {self.after_s:.2f} s"


def random_moment(rng: random.Random) -> Moment:
    """Half of them while it starts: imports, kernels, connections; half while it works."""
    after_s = rng.uniform(0.05, 2.0) if rng.random() < 0.5 else rng.uniform(2.0, 7.0)
    number = rng.choice([signal.SIGINT, signal.SIGTERM])
    return Moment(after_s, number, twice=rng.random() < 0.2)


def problems_of(moment: Moment, cache: Path) -> list[str]:
    """Start the whole stack, end it, and return what is wrong or left.

    Args:
        moment: when and how it is ended.
        cache: for likelihood fields, so that they are made once.
    """
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background ignores it
    shared_before = shared_memory()
    with tempfile.TemporaryDirectory(prefix="mcl-") as folder:
        own = Path(folder) / "tmp"
        own.mkdir()
        words = [*SMALL, f"worker.cache_folder={cache}"]
        words.append(f"zenoh.router=unixsock-stream/{folder}/r")
        log = Path(folder) / "log.txt"
        with log.open("wb") as output:
            popen = subprocess.Popen(
                [*COMMAND, *(word for setting in words for word in ("--set", setting))],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
                env={
                    **os.environ,
                    "TMPDIR": str(own),
                    "XDG_STATE_HOME": str(Path(folder) / "state"),
                },
                start_new_session=True,
            )
        problems = _problems_at_the_end(popen, moment)
        printed = log.read_text(errors="replace")
        if ("Traceback" in printed and OURS in printed) or "Timeout (" in printed:
            problems.append(f"it said:\n{printed}")
        if left := sorted(file.name for file in own.iterdir()):
            problems.append(f"left in the temporary folder: {left}")
    if left := sorted(shared_memory() - shared_before):
        problems.append(f"left in /dev/shm: {left}")
    return problems


def _problems_at_the_end(popen: subprocess.Popen[bytes], moment: Moment) -> list[str]:
    time.sleep(moment.after_s)  # the random moment itself
    started_s = time.monotonic()
    for _ in range(2 if moment.twice else 1):
        popen.send_signal(moment.number)
    code: int | None = None
    while (code := popen.poll()) is None or members(popen.pid):
        if time.monotonic() - started_s > _LOST_AFTER_S:
            break
        time.sleep(0.01)
    took_s = time.monotonic() - started_s
    problems: list[str] = []
    if took_s > END_WITHIN_S:
        names = [" ".join(process.cmdline()[2:4]) for process in members(popen.pid)]
        problems.append(f"ended after {took_s:.1f} s; still there: {names}")
    if code not in CLEAN_CODES:
        problems.append(f"exit code {code}")
    for process in members(popen.pid):
        process.kill()
    return problems


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


def assert_all_end_cleanly(seeds: range, cache: Path) -> None:
    for seed in seeds:
        moment = random_moment(random.Random(seed))
        assert problems_of(moment, cache) == [], str(moment)


@pytest.mark.parametrize("seed", [0, 1, 4, 7])  # both signals, once and twice, early and late
def test_a_stack_ended_at_any_moment_ends_cleanly_within_three_seconds(
    seed: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    cache = tmp_path_factory.getbasetemp() / "likelihood-fields"
    assert_all_end_cleanly(range(seed, seed + 1), cache)


@pytest.mark.soak
@pytest.mark.timeout(3600)
def test_two_hundred_cycles_of_start_and_stop_end_cleanly(tmp_path: Path) -> None:
    assert_all_end_cleanly(range(1000, 1200), tmp_path)
