"""A soak from its first process to its last verdict."""

from pathlib import Path
from urllib.parse import quote

import msgspec

from clustermcl.stack import meeting_in, temporary_folder
from process_runtime.settings import Settings
from process_runtime.stop import StopFlag
from protocol.errors import SettingsError
from soak_test.fleet import Fleet, robots_settings
from soak_test.history import history_verdicts
from soak_test.leftovers import (
    ended_verdict,
    exits_verdict,
    kept_logs,
    left_files,
    processes_left,
    temporary_files_in,
)
from soak_test.loop import Soak
from soak_test.options import SoakOptions
from soak_test.progress import Progress
from soak_test.report import SoakResult
from soak_test.rooms import PLACES

RECORDED_MB = 2_000.0
"""Of each robot's history; an hour of ten steps a second is a tenth of it."""


def run_soak(
    options: SoakOptions, settings: Settings, stop: StopFlag, progress: Progress
) -> SoakResult:
    """Run everything, break what is to be broken, and judge.

    Raises:
        NotReadyError: a robot did not find its first places.
        SettingsError: the world needs more clusters.
        StoppedError: told to stop before there was anything to judge.
        ClusterMclError: an input cannot be used, or a process failed at its start.
    """
    places = PLACES if options.rooms else None
    if places is not None and settings.belief.max_clusters < places:
        raise SettingsError(
            key="belief.max_clusters",
            problem=f"belief.max_clusters = {settings.belief.max_clusters}: eight rooms alike need "
            f"{places}; or choose another --world",
        )
    with temporary_folder() as folder, temporary_files_in(folder) as left:
        robots = robots_settings(_kept_in(folder, settings), options.robots)
        flights = Path(robots[0].recorder.folder)
        fleet = Fleet(
            robots, folder, world=options.world, rate_hz=options.rate_hz,
            coordinators=options.coordinators, cables=options.chaos,
        )  # fmt: skip
        soak = Soak(options, robots, fleet, stop, progress)
        try:
            fleet.start()
            soak.run()
        finally:
            soak.wake_all()
            stop_s = fleet.stop()
            if options.logs is not None:
                kept_logs(fleet.log_files(), options.logs)
        stop.take_time()  # an hour's history takes minutes, also for who has ended the soak
        faults, exits = soak.faults, fleet.exits
        verdicts = [
            exits_verdict(exits, faults, fleet.log_files()),
            ended_verdict(
                processes_left(soak.known, folder),
                soak.zombies(),
                left_files(left),
                stop_s,
            ),
            *history_verdicts({flights / quote(name): told for name, told in soak.heard.items()}),
        ]
    return soak.result(verdicts)


def _kept_in(folder: Path, settings: Settings) -> Settings:
    """The same settings, but nothing is left anywhere else, nor found there."""
    coordinator = msgspec.structs.replace(settings.coordinator, state_folder=str(folder / "state"))
    recorder = msgspec.structs.replace(
        settings.recorder, folder=str(folder / "flights"), max_mb=RECORDED_MB
    )
    kept = msgspec.structs.replace(settings, coordinator=coordinator, recorder=recorder)
    return meeting_in(folder, kept)
