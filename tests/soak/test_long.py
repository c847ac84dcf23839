"""Runs of an hour, left out unless asked for: ``pytest -m soak tests/soak``."""

import json
import math
import os
from pathlib import Path

import pytest

from tests.integration.system.commands import typed

pytestmark = pytest.mark.soak

MANY_STEPS = ["--rate-hz", "20", "--world", "hall", "--workers", "4", "--coordinators", "2"]
"""Few clusters, that two cores have time for them: what grows by the step, grows ten times faster
than at two steps a second."""


@pytest.mark.timeout(4500)
@pytest.mark.parametrize(
    ("words", "p99_s"),
    [
        pytest.param(["--minutes", "60", "--chaos"], math.inf, id="an hour of chaos"),
        pytest.param(["--minutes", "60"], math.inf, id="an hour of peace"),
        pytest.param(
            ["--minutes", "30", *MANY_STEPS],
            math.inf,
            id="five hours' steps of two a second in half an hour",
        ),
        pytest.param(
            ["--minutes", "10", "--rate-hz", "40"],
            1 / 40,
            id="ten minutes at 40 Hz, beliefs before the next scan",
        ),
    ],
)
def test_no_promise_is_broken(
    words: list[str], p99_s: float, short_folder: str, tmp_path: Path
) -> None:
    file = tmp_path / "soak.json"
    every = ["--seed", "1", "--output", str(file), *words]
    environment = {**os.environ, "TMPDIR": short_folder}
    with typed(*every, folder=tmp_path, environment=environment, module="tests.soak") as soak:
        code = soak.wait(4400.0)
        assert code == 0, soak.out + soak.err
    result = json.loads(file.read_text())
    assert result["kept"]
    promises = {each["promise"]: each["figures"] for each in result["promises"]}
    assert promises["each step is decided once"]["p99_s"] < p99_s
