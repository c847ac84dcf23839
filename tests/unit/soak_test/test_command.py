import sys
from dataclasses import replace
from pathlib import Path

import pytest
from rich.console import Console

from particle_filter.settings import BeliefSettings
from process_runtime.output_files import OutputError
from process_runtime.settings import Settings
from process_runtime.stop import StopFlag
from protocol.errors import SettingsError
from robot_simulator.worlds.world import UnknownWorldError
from soak_test.command import soak
from soak_test.options import SoakOptions
from soak_test.progress import ConsoleProgress
from soak_test.run import run_soak

OPTIONS = SoakOptions(
    minutes=1.0,
    robots=1,
    coordinators=1,
    rate_hz=10.0,
    world="eight_rooms",
    chaos=True,
    fault_every_s=20.0,
    only=(),
    json_file=None,
    logs=None,
)


def run(options: SoakOptions, settings: Settings) -> None:
    run_soak(options, settings, StopFlag(), ConsoleProgress(Console(), 1.0))


def test_without_psutil_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "psutil", None)
    with pytest.raises(SettingsError, match=r"clustermcl\[soak\]"):
        soak()


def test_a_fault_that_is_none_is_refused_with_those_that_are() -> None:
    with pytest.raises(SettingsError, match=r"'fire' is no fault; known are: worker killed, "):
        soak(only=["fire"])


def test_too_few_clusters_for_the_rooms_are_refused_before_anything_starts() -> None:
    with pytest.raises(SettingsError, match="eight rooms alike need 8"):
        run(OPTIONS, Settings(belief=BeliefSettings(max_clusters=4)))


def test_a_world_that_is_none_is_refused() -> None:
    with pytest.raises(UnknownWorldError, match="no simulated world 'moon'"):
        run(replace(OPTIONS, world="moon"), Settings())


@pytest.mark.parametrize("option", ["json_file", "logs"])
def test_an_output_that_cannot_be_written_is_refused_before_anything_starts(
    option: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("soak_test.run.run_soak", lambda *_: pytest.fail("it has started"))
    given = {option: Path("/dev/null/x")}
    with pytest.raises(OutputError, match="/dev/null/x: cannot be written"):
        soak(**given)  # type: ignore[arg-type] # both are paths
