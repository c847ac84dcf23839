"""docs/failures.md: scans with steps far ahead change no belief while the real bridge
continues."""

import zenoh
from msgspec.structs import replace

from clustermcl.commands.stack import COORDINATOR
from clustermcl.protocol import keys
from clustermcl.protocol.codec import encode
from clustermcl.protocol.message import MAX_SCAN_STEP
from clustermcl.protocol.steps import Scan
from tests.integration.faults.live_robot import BRIDGE, assert_same_as_alone, with_live_robot
from tests.integration.faults.system import System
from tests.integration.waiting import wait_until

HIGHEST = 2**53 - 1
BURST = 4


def forge(tested: System, first_step: int, count: int) -> None:
    scan = tested.next_message(keys.SCAN, Scan)
    for n in range(count):
        forged = replace(scan, step=first_step + n, stamp_ns=scan.stamp_ns + n * 1_000_000)
        block = zenoh.CongestionControl.BLOCK
        tested.session.put(keys.SCAN, encode(forged), congestion_control=block)


def test_single_scans_far_ahead_change_no_belief_and_after_a_burst_a_restart_localizes_again() -> (
    None
):
    with with_live_robot() as (tested, _robot), tested.client as client:
        tested.wait_until_it_tracks()
        for step, cause in ((HIGHEST, "malformed Scan: field"), (10**9, "scan far ahead")):
            forge(tested, step, 1)
            tested.wait_for_steps(5)
            wait_until(lambda cause=cause: client.status().counters.get(cause) == 1)
        assert client.status().counters.get("steps restarted", 0) == 0
        assert_same_as_alone(tested)

        for restarted in (BRIDGE, COORDINATOR):
            forge(tested, MAX_SCAN_STEP - BURST, BURST)
            wait_until(lambda: tested.step >= MAX_SCAN_STEP - BURST)
            tested.restart(restarted)
            wait_until(lambda: tested.tracks() and numbers_steps_from_0(tested))
            wait_until(lambda: client.pose().freshness == "fresh")


def numbers_steps_from_0(tested: System) -> bool:
    return max(belief.step for belief in tested.beliefs[-20:]) < MAX_SCAN_STEP // 2
