"""The coordinator process."""

import argparse
import logging
import time
from contextlib import ExitStack, closing
from pathlib import Path

from clustermcl.coordinator.coordinator import Started
from clustermcl.coordinator.loop import Loop
from clustermcl.coordinator.recorder.flight_recorder import FlightRecorder
from clustermcl.coordinator.recorder.ring import Ring
from clustermcl.coordinator.replica import Replica
from clustermcl.coordinator.state_file import StateKeeper, read
from clustermcl.filter.settings import FilterSettings
from clustermcl.link.metrics import metrics_served
from clustermcl.link.node import Node
from clustermcl.link.wire import is_alive
from clustermcl.protocol import keys
from clustermcl.protocol.errors import AlreadyRunningError
from clustermcl.protocol.work import Checkpoint
from clustermcl.runtime.folders import owned, recording_folder, state_folder
from clustermcl.runtime.main import Invocation, process_main
from clustermcl.runtime.version import VERSION

_log = logging.getLogger(__name__)


def main() -> None:
    describe = "Coordinator of Cluster-MCL: weighs clusters, places jobs, answers the pose."
    process_main("coordinator", run_coordinator, describe=describe, add_arguments=_add_arguments)


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--standby",
        action="store_true",
        help="wait while the robot has a coordinator, and take over when it dies",
    )


def run_coordinator(invocation: Invocation) -> None:
    """Lead or follow until the process is stopped.

    Raises:
        AlreadyRunningError: the robot has a coordinator, and `standby` is off.
    """
    settings, stop = invocation.settings, invocation.stop
    may_wait = settings.coordinator.standby or invocation.arguments.standby
    replica = Replica(settings.coordinator.take_over_after_s, time.monotonic_ns())
    while not stop.is_set():
        with closing(Node(invocation.process, "coordinator", settings, stop, peers=None)) as node:
            node.open()
            follow_and_lead(invocation, node, replica, may_wait=may_wait)
        may_wait = True  # this coordinator was deposed


def follow_and_lead(
    invocation: Invocation, node: Node, replica: Replica, *, may_wait: bool
) -> None:
    settings = invocation.settings
    with metrics_served(settings.metrics, settings.robot.name, lambda: node.session):
        loop = Loop(node, replica, settings.robot.radius_m)
        # After a deposition: a successor declares its liveliness token only after recovery.
        if replica.role == "deposed" or is_alive(
            node.session, keys.COORDINATOR_ALIVE, settings.zenoh.query_timeout_s
        ):
            if not may_wait:
                raise AlreadyRunningError(
                    what="a coordinator",
                    robot=settings.robot.name,
                    endpoint=settings.zenoh.router,
                    advice="stop it, start this one with --standby, or choose another robot.name",
                )
            if not loop.follow():
                return
            _log.warning("the coordinator is dead: taking over")
        lead(invocation, loop, replica.newest)


def lead(invocation: Invocation, loop: Loop, known: Checkpoint | None) -> None:
    settings = invocation.settings
    robot, term = settings.robot.name, time.time_ns() // 1_000
    with ExitStack() as claims:

        def own(folder: Path | None) -> Path | None:
            return folder if folder and claims.enter_context(owned(folder, settings)) else None

        folder = own(state_folder(settings.coordinator.state_folder))
        recorded = own(recording_folder(settings))
        started = Started(
            sender=invocation.process,
            filter_settings=filter_settings(settings),
            settings=settings.coordinator,
            bridge=settings.bridge,
            version=VERSION,
            now_ns=time.monotonic_ns(),
            term=term,
            known=known,
            kept=read(folder, robot) if folder else None,
        )
        coordinator = started.coordinator()
        ring = Ring(recorded, term, int(settings.recorder.max_mb * 1e6)) if recorded else None
        keeper = StateKeeper(folder, robot, started.kept)
        loop.lead(coordinator, keeper, FlightRecorder(coordinator, ring))
    if coordinator.term.outranked_by is not None:
        _log.warning(
            "another coordinator has acted since term %d: stepping down",
            coordinator.term.outranked_by,
        )


def filter_settings(settings: FilterSettings) -> FilterSettings:
    """Return the filter's settings without those of the processes, as work orders contain them."""
    return FilterSettings(
        **{name: getattr(settings, name) for name in FilterSettings.__struct_fields__}
    )
