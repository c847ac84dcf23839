"""Scans at 40 Hz, every one a step, eight clusters of the usual size, one a worker."""

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tests.integration.system.commands import typed
from tests.integration.waiting import PATIENCE_S

MINUTES = 0.15


@contextmanager
def other_work(processes: int) -> Iterator[None]:
    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(processes)]
    try:
        yield
    finally:
        for one in busy:
            one.kill()
            one.wait()


def test_some_seconds_at_forty_hertz_under_other_load_lose_no_step_and_no_place(
    tmp_path: Path,
) -> None:
    """An overloaded bridge makes fewer steps of the scans; the delay of a belief is not checked.

    `python -m tests.soak --rate-hz 40` shows it without other load.
    """
    file = tmp_path / "soak.json"
    words = ["--minutes", str(MINUTES), "--rate-hz", "40", "--workers", "8", "--seed", "1"]
    words += ["--set", "search.poses=20000", "--set", "belief.search_every_steps=1000000000"]
    with typed(*words, "--output", str(file), folder=tmp_path, module="tests.soak") as soak:
        soak.wait_for(f"0.0 of {MINUTES:g} min")  # the first search is over
        with other_work(4):
            soak.wait(MINUTES * 60.0 + PATIENCE_S)
    promises = {each["promise"]: each for each in json.loads(file.read_text())["promises"]}
    steps = promises["each step is decided once"]["figures"]
    assert steps["steps"] > 0
    assert steps["lost"] == 0
    assert promises["the true places are held, no wrong one is sure"]["kept"], soak.out
