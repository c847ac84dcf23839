"""A simulated robot that publishes its readings over Zenoh, like a real robot's driver.

``python -m tests.soak.driver --settings FILE --world WORLD --rate-hz 10``. The robot drives
on when the bridge that reads it dies and restarts.
"""

import argparse
import threading
import time

import msgspec
import zenoh

from clustermcl.link.session import open_session
from clustermcl.link.wire import Publisher
from clustermcl.protocol import keys
from clustermcl.protocol.message import Message, PoseTuple
from clustermcl.protocol.steps import OdometryReading
from clustermcl.runtime.main import Invocation, process_main
from clustermcl.runtime.stop import StopFlag
from clustermcl.simulator.simulation import Simulation
from tests.soak.eight_rooms import soak_world

TRUTH_KEY = "simulator/truth"
KIDNAP_KEY = "simulator/kidnap"
"""Any message on this key kidnaps the robot."""
SIMULATED_HZ = 10.0
"""Scans per second of simulated time; a higher `--rate-hz` makes simulated time run faster."""
_FROZEN_NS = 200_000_000
"""Delay above which the driver counts as frozen [ns]."""


class TrueMotion(Message, frozen=True, kw_only=True, tag="simulator_truth/1"):
    """Ground truth at the time of a scan. Published on ``simulator/truth`` for each scan."""

    stamp_ns: int
    """Time of the scan."""
    map_from_robot: PoseTuple
    kidnapped: int = 0
    """Number of times that the robot has been kidnapped."""


def main() -> None:
    process_main("robot", run_robot, describe="Simulated robot.", add_arguments=_add_arguments)


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--world", default="hall", help="simulated world (default: hall)")
    parser.add_argument(
        "--rate-hz",
        type=float,
        default=SIMULATED_HZ,
        help="scans per second (default: %(default)g)",
    )


def run_robot(invocation: Invocation) -> None:
    settings, arguments = invocation.settings, invocation.arguments
    world = soak_world(arguments.world)
    simulation = Simulation(world, settings.seed)
    with open_session(settings.zenoh, settings.robot, invocation.stop, wait_s=None) as session:
        _drive(session, simulation, 1.0 / arguments.rate_hz, invocation.stop)


def _drive(session: zenoh.Session, simulation: Simulation, period_s: float, stop: StopFlag) -> None:
    odometry = Publisher(session, keys.ODOMETRY_READING)
    laser = Publisher(session, keys.LASER_READING)
    truth = Publisher(session, TRUTH_KEY)
    lift, kidnapped = threading.Event(), 0
    session.declare_subscriber(KIDNAP_KEY, lambda _sample: lift.set())
    clock = _Clock(SIMULATED_HZ * period_s)
    for tick in simulation:
        for reading in tick.readings:
            stamp_ns = clock.stamp_ns(reading.stamp_ns)
            stop.wait((stamp_ns - time.time_ns()) / 1e9)
            if stop.is_set():
                return
            stamped = msgspec.structs.replace(reading, stamp_ns=stamp_ns)
            if isinstance(stamped, OdometryReading):
                odometry.put(stamped)
                continue
            pose = tick.map_from_robot
            truth.put(
                TrueMotion(
                    sender="robot", stamp_ns=stamp_ns, map_from_robot=pose, kidnapped=kidnapped
                )
            )
            laser.put(stamped)
        if lift.is_set():
            lift.clear()
            simulation.kidnap()
            kidnapped += 1


class _Clock:
    """Converts simulated time to Unix time; simulated time stands still while frozen."""

    def __init__(self, seconds_each: float) -> None:
        self._seconds_each = seconds_each
        self._zero_ns = time.time_ns()

    def stamp_ns(self, simulated_ns: int) -> int:
        due_ns = self._zero_ns + int(simulated_ns * self._seconds_each)
        late_ns = time.time_ns() - due_ns
        if late_ns > _FROZEN_NS:
            self._zero_ns += late_ns
            return due_ns + late_ns
        return due_ns


if __name__ == "__main__":
    main()
