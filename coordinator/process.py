"""The coordinator process."""

import argparse
import logging
import time
from functools import partial
from importlib.metadata import version
from pathlib import Path
from urllib.parse import quote

import zenoh

from coordinator.loop import CoordinatorLoop
from coordinator.newest_checkpoint import NewestCheckpoint
from coordinator.recorder.flight_recorder import FlightRecorder
from coordinator.recorder.records import Started
from coordinator.recorder.ring import Ring
from coordinator.standby import StandbyLoop
from coordinator.state_file import StateKeeper, read
from particle_filter.settings import FilterSettings
from process_runtime.logs import CauseCounter
from process_runtime.main import Invocation, process_main
from process_runtime.settings import CoordinatorSettings, Settings
from process_runtime.state_folder import default_state_folder
from protocol import keys
from protocol.errors import AlreadyRunningError
from zenoh_link.metrics import metrics_served
from zenoh_link.session import open_session
from zenoh_link.stale_session import is_there
from zenoh_link.wire import is_alive

_log = logging.getLogger(__name__)


def main() -> None:
    """Run the coordinator."""
    process_main(
        "coordinator",
        run_coordinator,
        describe="Coordinator of Cluster-MCL: weighs clusters, places jobs, answers the pose.",
        add_arguments=_add_arguments,
    )


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--standby",
        action="store_true",
        help="wait while the robot has a coordinator, and take over when it dies",
    )


def run_coordinator(invocation: Invocation) -> None:
    """Coordinate, or stand by, until told to stop.

    Raises:
        AlreadyRunningError: the robot has a coordinator, and this one was not told to stand by.
    """
    settings, stop = invocation.settings, invocation.stop
    may_wait = settings.coordinator.standby or invocation.arguments.standby
    causes = CauseCounter()
    is_deposed, newest = False, NewestCheckpoint()
    while not stop.is_set():
        with (
            open_session(settings.zenoh, settings.robot, stop, wait_s=None) as session,
            metrics_served(settings.metrics, session),
        ):
            # Who has deposed this one may be about to begin, and shows itself only then.
            if is_deposed or is_alive(
                session, keys.COORDINATOR_ALIVE, settings.zenoh.query_timeout_s
            ):
                if not may_wait:
                    raise AlreadyRunningError(
                        what="a coordinator",
                        robot=settings.robot.name,
                        endpoint=settings.zenoh.router,
                        advice="stop it, start this one with --standby, "
                        "or choose another robot.name",
                    )
                sees = partial(is_there, settings.zenoh, settings.robot, stop)
                standby = StandbyLoop(
                    session,
                    settings.coordinator.take_over_after_s,
                    partial(sees, keys.COORDINATOR_ALIVE),
                    newest,
                )
                if not standby.run(stop):
                    continue
                _log.warning("the coordinator is dead: taking over")
            known, newest = newest, NewestCheckpoint()
            is_deposed = lead(invocation, session, known, newest, causes)
            may_wait = True  # another acts: whatever this one was told, it may only wait


def lead(
    invocation: Invocation,
    session: zenoh.Session,
    known: NewestCheckpoint,
    heard: NewestCheckpoint,
    causes: CauseCounter,
) -> bool:
    """Coordinate until told to stop, or until another coordinator acts: that is true then.

    Args:
        invocation: of the process.
        session: to the robot's other processes.
        known: what others published before.
        heard: told of what others publish meanwhile, from which this one may carry on later.
        causes: counts what is refused.
    """
    settings = invocation.settings
    folder = state_folder(settings.coordinator)
    robot = settings.robot.name
    started = Started(
        sender=invocation.process,
        filter_settings=filter_settings(settings),
        settings=settings.coordinator,
        bridge=settings.bridge,
        version=version("clustermcl"),
        now_ns=time.monotonic_ns(),
        term=time.time_ns() // 1_000,
        known=known.checkpoint,
        usual_delay_ns=known.usual_delay_ns,
        kept=read(folder, robot) if folder else None,
    )
    coordinator = started.coordinator()
    keeper = StateKeeper(folder, robot, started.kept)
    recorder = FlightRecorder(coordinator, started, recorder_ring(settings, started.term))
    with recorder.running():
        sees = partial(is_there, settings.zenoh, settings.robot, invocation.stop)
        is_anybody_there = partial(sees, keys.ALL_WORKERS_ALIVE)
        loop = CoordinatorLoop(
            coordinator, session, keeper, recorder, heard, causes, is_anybody_there
        )
        loop.run(invocation.stop)
    if coordinator.outranked_by is None:
        return False
    _log.warning("another coordinator acts since term %d: stepping down", coordinator.outranked_by)
    return True


def state_folder(settings: CoordinatorSettings) -> Path | None:
    """Where the state is kept; None for nowhere."""
    named = settings.state_folder
    if named == "off":
        return None
    try:
        return Path(named).expanduser() if named else default_state_folder()
    except RuntimeError as error:  # a service without a home
        _log.warning("the state is not kept: %s; set coordinator.state_folder", error)
        return None


def recorder_ring(settings: Settings, series: int) -> Ring | None:
    """Where a coordinator's flight recording goes; None for nowhere."""
    folder, max_bytes = settings.recorder.folder, int(settings.recorder.max_mb * 1e6)
    if folder in ("", "off"):
        return None
    robot = quote(settings.robot.name, safe="")
    return Ring(Path(folder).expanduser() / robot, series, max_bytes)


def filter_settings(settings: FilterSettings) -> FilterSettings:
    """The filter's numbers alone, as they travel in work orders."""
    return FilterSettings(
        seed=settings.seed,
        motion=settings.motion,
        sensor=settings.sensor,
        cluster=settings.cluster,
        search=settings.search,
        belief=settings.belief,
    )
