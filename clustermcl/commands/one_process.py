"""All parts of a robot in one process, for the smallest computers: `clustermcl up --one-process`.

The bridge or simulator, one worker and the coordinator run in threads and share one Zenoh session,
which is also the router. So keys, messages and beliefs are those of many processes. There is no
fault tolerance: the process ends when a part ends, and continues from the coordinator's state file.
"""

import logging
import time
from collections.abc import Callable
from dataclasses import replace

from clustermcl.coordinator.process import follow_and_lead
from clustermcl.coordinator.replica import Replica
from clustermcl.filter.settings import SensorSettings
from clustermcl.jobs.warm_up import compile_kernels
from clustermcl.link.configuration import as_zenoh, router_configuration
from clustermcl.link.node import Node
from clustermcl.link.router import listen
from clustermcl.protocol.errors import SettingsError
from clustermcl.runtime.folders import kept_folder
from clustermcl.runtime.main import Invocation, process_main
from clustermcl.runtime.settings import Settings
from clustermcl.runtime.sources import Simulated, parsed_source
from clustermcl.runtime.stop import StopFlag
from clustermcl.runtime.threads import run_in_threads
from clustermcl.sensor_bridge.process import run_bridge
from clustermcl.worker.process import WorkerLoop

_log = logging.getLogger(__name__)


def main() -> None:
    process_main(
        "one-process",
        run_parts,
        describe="Cluster-MCL in one process, without fault tolerance.",
    )


def run_parts(invocation: Invocation) -> None:
    settings, stop = invocation.settings, invocation.stop
    refused = {
        "zenoh.start_router=false": not settings.zenoh.start_router,
        f"worker.count={settings.worker.count}": settings.worker.count > 1,
        "coordinator.standby=true": settings.coordinator.standby,
    }
    for setting, is_refused in refused.items():
        if is_refused:
            problem = f"{setting} needs several processes: leave it out, or --one-process"
            raise SettingsError(key=setting.partition("=")[0], problem=problem)
    compile_kernels(SensorSettings())
    robot = router_configuration(settings.zenoh) | {"namespace": settings.robot.name}
    with listen(as_zenoh(robot), settings.zenoh.router) as session:
        _log.info("robot %r in one process, without fault tolerance", settings.robot.name)

        def part(stop: StopFlag) -> Invocation:
            return replace(invocation, session=session, stop=stop)

        # It declares its token before the coordinator looks for workers.
        node = _node(part(stop), "worker")
        cache = kept_folder("maps", settings.worker.cache_folder)
        worker = WorkerLoop(node, cache, lambda _jobs: None)

        def work(stop: StopFlag) -> None:
            node.stop = stop
            worker.run()

        bridge = _bridge_of(settings)
        run_in_threads(
            [work, lambda stop: _coordinate(part(stop)), lambda stop: bridge(part(stop))], stop
        )


def _coordinate(invocation: Invocation) -> None:
    replica = Replica(invocation.settings.coordinator.take_over_after_s, time.monotonic_ns())
    follow_and_lead(invocation, _node(invocation, "coordinator"), replica, may_wait=False)


def _node(invocation: Invocation, role: str) -> Node:
    name, settings = invocation.process, invocation.settings
    node = Node(name, role, settings, invocation.stop, peers=None, session=invocation.session)
    node.open()
    return node


def _bridge_of(settings: Settings) -> Callable[[Invocation], None]:
    if not isinstance(parsed_source(settings.bridge.source), Simulated):
        return run_bridge
    from clustermcl.simulator.process import run_with_defaults  # noqa: PLC0415 - 20 MB that a robot saves

    return run_with_defaults


if __name__ == "__main__":
    main()
