"""The coordinator process."""

import time
from importlib.metadata import version

from coordinator.coordinator import Coordinator
from coordinator.loop import CoordinatorLoop
from particle_filter.settings import FilterSettings
from process_runtime.main import Invocation, process_main
from process_runtime.session import open_session
from process_runtime.wire import is_alive
from protocol import keys
from protocol.errors import AlreadyRunningError


def main() -> None:
    """Run the coordinator."""
    process_main(
        "coordinator",
        run_coordinator,
        describe="Coordinator of Cluster-MCL: weighs clusters, places jobs, answers the pose.",
    )


def run_coordinator(invocation: Invocation) -> None:
    """Coordinate until told to stop.

    Raises:
        AlreadyRunningError: the robot has a coordinator.
    """
    settings = invocation.settings
    with open_session(settings.zenoh, settings.robot, invocation.stop, wait_s=None) as session:
        if is_alive(session, keys.COORDINATOR_ALIVE, settings.zenoh.query_timeout_s):
            raise AlreadyRunningError(
                f"robot {settings.robot.name!r} has a coordinator already at "
                f"{settings.zenoh.router}: stop it, or choose another robot.name"
            )
        coordinator = Coordinator(
            invocation.process,
            filter_settings(settings),
            settings.coordinator,
            version("clustermcl"),
            time.monotonic_ns(),
        )
        CoordinatorLoop(coordinator, session).run(invocation.stop)


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
