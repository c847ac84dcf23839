"""The soak test itself, short: what is promised is kept, and what is broken is noticed."""

import json
import os
import subprocess
from pathlib import Path

import pytest

from tests.integration.system.commands import COMMAND, typed
from tests.integration.waiting import PATIENCE_S
from tests.soak.schedule import Kind

MINUTES = 0.5
SEED = 7
KINDS = [kind for kind in Kind if kind is not Kind.ROBOT_KIDNAPPED]
"""Not all promises are kept yet where a search follows closely; docs/results.md lists them."""


@pytest.mark.timeout(420)
def test_half_a_minute_of_faults_breaks_no_promise_that_holds_on_a_busy_machine(
    short_folder: str, tmp_path: Path
) -> None:
    """The true places and a clean end do not depend on the load; times do.

    `python -m tests.soak --chaos` itself demands all; docs/results.md has an hour of it.
    """
    file, kept = tmp_path / "soak.json", tmp_path / "kept"
    words = [
        "--chaos", "--minutes", f"{MINUTES}", "--fault-every-s", "3",
        "--seed", f"{SEED}", "--output", str(file), "--keep", str(kept),
    ]  # fmt: skip
    words += [word for kind in KINDS for word in ("--only", kind)]
    environment = {**os.environ, "TMPDIR": short_folder}
    with typed(*words, folder=tmp_path, environment=environment, module="tests.soak") as soak:
        soak.wait_for(f"0.0 of {MINUTES:g} min")
        code = soak.wait(MINUTES * 60.0 + 2 * PATIENCE_S)
        soak.assert_nothing_runs()
    result = json.loads(file.read_text())
    assert code == (0 if result["kept"] else 1), soak.err
    promises = {each["promise"]: each for each in result["promises"]}
    assert promises["the true places are held, no wrong one is sure"]["kept"], soak.out
    broken = promises["a clean end"]["breaks"]
    assert [one for one in broken if "s to end" not in one] == [], soak.out
    answered = promises["the pose is answered"]["figures"]
    steps = promises["each step is decided once"]["figures"]
    age = promises["the pose's age is true"]["figures"]
    assert answered["share"] >= 0.8, soak.out
    assert steps["lost"] <= 0.2 * steps["steps"], soak.out
    assert age["wrong_fresh"] <= 0.1 * answered["asked"], soak.out
    replay = [*COMMAND, "replay", str(kept / "flights" / "robot")]
    assert subprocess.run(replay, capture_output=True, check=False).returncode == 0
    kinds = {fault["kind"] for fault in result["faults"]}
    assert len(kinds) >= 2, "a freeze takes 10 s of the half minute"
    assert list(Path(short_folder).iterdir()) == []
