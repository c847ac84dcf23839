from pathlib import Path

import pytest
from rich.console import Console

from particle_filter.settings import BeliefSettings
from process_runtime.output_files import OutputError
from process_runtime.settings import Settings
from process_runtime.stop import StopFlag
from protocol.errors import SettingsError
from robot_simulator.worlds.world import UnknownWorldError
from tests.soak.__main__ import soak
from tests.soak.report import Progress
from tests.soak.soak import SoakOptions, run_soak


def run(world: str, settings: Settings) -> None:
    options = SoakOptions(
        minutes=1.0, coordinators=1, rate_hz=10.0, world=world, chaos=True, fault_every_s=20.0,
        only=(), keep=None,
    )  # fmt: skip
    run_soak(options, settings, StopFlag(), Progress(Console(), 1.0))


def test_too_few_clusters_for_the_rooms_are_refused_before_anything_starts() -> None:
    with pytest.raises(SettingsError, match="eight rooms alike need 8"):
        run("eight_rooms", Settings(belief=BeliefSettings(max_clusters=4)))


def test_an_unknown_world_is_refused() -> None:
    with pytest.raises(UnknownWorldError, match="no simulated world 'moon'"):
        run("moon", Settings())


@pytest.mark.parametrize("option", ["output", "keep"])
def test_an_output_that_cannot_be_written_is_refused_before_anything_starts(
    option: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tests.soak.__main__.run_soak", lambda *_: pytest.fail("it has started"))
    given = {option: Path("/dev/null/x")}
    with pytest.raises(OutputError, match="/dev/null/x: cannot be written"):
        soak(**given)  # type: ignore[arg-type] # both are paths
