from itertools import pairwise
from typing import Any

import pytest

from clustermcl.commands.stack import COORDINATOR
from clustermcl.protocol import keys
from clustermcl.protocol.answers import CommandDone, Configure
from clustermcl.protocol.live_settings import LiveSettings
from clustermcl.ros2 import message_types as types
from clustermcl.ros2.message_types import new, request_of
from clustermcl.ros2.topics import BOND
from clustermcl.simulator.worlds.catalogue import world
from tests.integration.alone import assert_same, outcomes_of_scans
from tests.integration.ros2.robot import RosRobot
from tests.integration.ros2.test_whole_way import WORLD, Drive, robot_and_system
from tests.integration.waiting import answered, stretched_s, wait_until

EXPECTED = LiveSettings(
    gate_distance_m=0.1, turn_noise_per_turn=0.5, max_beams=31, hit_sigma_m=0.3, hit_weight=0.6
)


def set_parameters(robot: RosRobot, **values: float) -> list[Any]:
    kind = types.SET_PARAMETERS
    parameters = []
    for name, value in values.items():
        is_whole = isinstance(value, int)
        fields = {"integer_value": value} if is_whole else {"double_value": value}
        reported = new("rcl_interfaces/msg/ParameterValue", type=2 if is_whole else 3, **fields)
        parameters.append(new("rcl_interfaces/msg/Parameter", name=name, value=reported))
    request = new(request_of(kind), parameters=parameters)
    results: list[Any] = robot.call("/amcl/set_parameters", kind, request).results
    return results


def assert_bond_went_on(beats_s: list[float]) -> None:
    gaps_s = [after - earlier for earlier, after in pairwise(beats_s)]
    assert max(gaps_s) < stretched_s(1.0)
    assert len(gaps_s) > 2


@pytest.mark.timeout(400)
def test_live_parameters_apply_from_the_next_step_and_with_the_bond_survive_every_take_over() -> (
    None
):
    with robot_and_system() as (tested, robot), tested.client as client:
        bonds, drive = robot.listen(BOND), Drive(robot, tested)
        with drive.driving():
            wait_until(lambda: tested.beliefs and not tested.beliefs[-1].searching, 120.0)
            tested.wait_for_steps(3)
            results = set_parameters(
                robot, update_min_d=0.1, alpha1=0.25, max_beams=31, sigma_hit=0.3, z_hit=0.6
            )
            assert [result.reason for result in results] == [""] * 5
            wait_until(lambda: tested.history()[-1].settings == EXPECTED)
            tested.wait_for_steps(6)
            count = len(bonds)
            tested.restart(COORDINATOR)
            tested.wait_for_steps(6)
            assert_bond_went_on(robot.received_at_s[BOND.name][count - 1 :])
            assert all(bond.active for bond in bonds)
            assert len({bond.instance_id for bond in bonds}) == 1
            scans, beliefs = tested.history(), list(tested.beliefs)
            assert client.status().settings == EXPECTED
            tested.restart("sensor_bridge")
            tested.wait_for_steps(3)
            assert tested.history()[-1].settings == EXPECTED
            # A restarted process receives them again.
            command = Configure(sender="test", settings=LiveSettings())
            done = answered(tested.session, keys.CONFIGURE, CommandDone, command)
            assert not done.problem
            wait_until(lambda: tested.history()[-1].settings == LiveSettings())
            wait_until(lambda: tested.history()[-1].settings == EXPECTED)
    # Every cluster was weighed by these numbers at each step: one process believes the same.
    assert {scan.settings for scan in scans} == {LiveSettings(), EXPECTED}
    compared = [belief for belief in beliefs if belief.step <= scans[-1].step]
    assert compared[-1].step > next(one.step for one in scans if one.settings == EXPECTED) + 5
    assert_same(compared, outcomes_of_scans(scans, world(WORLD).map, tested.settings))
