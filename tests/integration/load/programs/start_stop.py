"""Start-stop cycles of the whole stack, ended at random moments.

``python -m tests.integration.load.programs.start_stop --cycles 200`` prints what did not end
cleanly, and how long the ends took.
"""

import argparse
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

import psutil

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


@dataclass
class Ended:
    """The end of a stack."""

    code: int
    took_s: float
    """From the signal to the end of the last process."""
    problems: list[str] = field(default_factory=list)


def random_moment(rng: random.Random) -> Moment:
    """Half of them while it starts: imports, kernels, connections; half while it works."""
    after_s = rng.uniform(0.05, 2.0) if rng.random() < 0.5 else rng.uniform(2.0, 7.0)
    number = rng.choice([signal.SIGINT, signal.SIGTERM])
    return Moment(after_s, number, twice=rng.random() < 0.2)


def run_cycle(moment: Moment, cache: Path) -> Ended:
    """Start the whole stack, end it, and look for what is left.

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
        ended = _end(popen, moment)
        said = log.read_text(errors="replace")
        if ("Traceback" in said and OURS in said) or "Timeout (" in said:
            ended.problems.append(f"it said:\n{said}")
        if left := sorted(file.name for file in own.iterdir()):
            ended.problems.append(f"left in the temporary folder: {left}")
    if left := sorted(shared_memory() - shared_before):
        ended.problems.append(f"left in /dev/shm: {left}")
    return ended


def _end(popen: subprocess.Popen[bytes], moment: Moment) -> Ended:
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
    ended = Ended(popen.returncode if code is None else code, took_s)
    if took_s > END_WITHIN_S:
        names = [" ".join(process.cmdline()[2:4]) for process in members(popen.pid)]
        ended.problems.append(f"ended after {took_s:.1f} s; still there: {names}")
    if code not in CLEAN_CODES:
        ended.problems.append(f"exit code {code}")
    for process in members(popen.pid):
        process.kill()
    return ended


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


def main() -> int:
    """Run cycles; exit code 1 if one did not end cleanly."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cycles", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    rng = random.Random(arguments.seed)
    took_s: list[float] = []
    unclean = 0
    with tempfile.TemporaryDirectory(prefix="mcl-cache-") as cache:
        for cycle in range(arguments.cycles):
            moment = random_moment(rng)
            ended = run_cycle(moment, Path(cache))
            took_s.append(ended.took_s)
            unclean += bool(ended.problems)
            print(f"{cycle}: {moment}: code {ended.code}, {ended.took_s:.2f} s", flush=True)
            for problem in ended.problems:
                print(f"    {problem}", flush=True)
    took_s.sort()
    print(
        f"{arguments.cycles} cycles, {unclean} not clean; ended after median "
        f"{took_s[len(took_s) // 2]:.2f} s, at most {took_s[-1]:.2f} s"
    )
    return 1 if unclean else 0


if __name__ == "__main__":
    sys.exit(main())
