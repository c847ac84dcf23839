"""Processes are killed while the robot drives."""

import itertools
import time

import psutil
import pytest

from tests.integration.ros.conftest import StartDrive, StartNode
from tests.integration.ros.robot import Bond, Drive
from tests.integration.waiting import stretched_s, wait_until

SCAN_S = 0.1
GAP_S = 0.3
"""Promised: `map` to `odom` never pauses for longer."""
BOND_TIMEOUT_S = 4.0


def children(pid: int) -> dict[str, psutil.Process]:
    """The processes of the system below the node, by their modules."""
    found = {}
    for one in psutil.Process(pid).children(recursive=True):
        words = one.cmdline()
        if "-m" in words:
            found[f"{words[words.index('-m') + 1]} {one.pid}"] = one
    return found


def drive_at_pace(drive: Drive, seconds: float) -> float:
    """Drive with ten scans a second; return the longest pause of the transforms [s]."""
    before = set(drive.transforms)
    started_s = time.monotonic()
    for tick in drive.simulation:
        next_s = time.monotonic() + SCAN_S
        drive.step(tick, SCAN_S)
        wait_until(lambda until_s=next_s: time.monotonic() >= until_s)
        if time.monotonic() - started_s > seconds:
            break
    at_s = sorted(at_s for stamp, (at_s, _) in drive.transforms.items() if stamp not in before)
    at_s = [started_s, *at_s, time.monotonic()]
    return max(later - earlier for earlier, later in itertools.pairwise(at_s))


def test_each_process_of_the_system_may_be_killed(start_drive: StartDrive) -> None:
    drive = start_drive(parameters={"engine": "service", "worker.processes": 1})
    bond = Bond(drive.robot)
    drive.localize()
    drive.drive(20)
    pauses = {"none": drive_at_pace(drive, 2.0)}
    for name, process in children(drive.node.pid).items():
        if not process.is_running():
            continue
        process.kill()
        pauses[name] = drive_at_pace(drive, 3.0)
    assert len(pauses) >= 5  # router, bridge, coordinator, worker
    assert max(pauses.values()) < stretched_s(GAP_S), pauses
    assert bond.longest_pause_s() < BOND_TIMEOUT_S
    count = len(drive.poses)
    drive.drive_until(lambda: len(drive.poses) > count + 5)
    assert drive.error()[0] < 0.3


@pytest.mark.parametrize("engine", ["inside", "service"])
def test_a_killed_node_continues_with_its_bond(
    start_drive: StartDrive, start_node: StartNode, engine: str
) -> None:
    drive = start_drive(active=False, parameters={"engine": engine})
    robot, bond = drive.robot, Bond(drive.robot)
    robot.activate()
    drive.localize()
    wait_until(bond.is_alive)
    below = children(drive.node.pid).values()
    drive.node.kill()
    killed_s = time.monotonic()
    again = start_node(parameters={"engine": engine})
    if time.monotonic() - killed_s < BOND_TIMEOUT_S - 1.0:
        again.wait_for("continuing the state of the killed node")
    elif robot.state() != "active":  # a busy machine starts it too late
        robot.activate()
    count = len(drive.transforms)
    drive.drive_until(lambda: len(drive.transforms) > count)
    assert robot.state() == "active"
    if "continuing the state" in again.err:
        assert len({status.instance_id for _, status in bond.heard}) == 1
    wait_until(lambda: not any(one.is_running() for one in below))
