from dataclasses import replace
from itertools import islice
from math import hypot, pi

import numpy as np
import pytest

from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.runtime.settings import BridgeSettings
from clustermcl.simulator import robot
from clustermcl.simulator.free_space import FreeSpace
from clustermcl.simulator.sensors import Lidar, LidarModel
from clustermcl.simulator.simulation import Simulation, simulated_steps
from clustermcl.simulator.worlds.catalogue import world
from clustermcl.simulator.worlds.world import world_from_map

HALL = world("hall")
ROOM = GridMap(np.pad(np.zeros((80, 120), np.int8), 2, constant_values=1), 0.05, (-0.1, -0.1, 0.0))
"""From (0, 0) to (6, 4) m."""
PERFECT = LidarModel(range_noise_m=0.0, drop_out_share=0.0, robot_from_laser=(0.0, 0.0, 0.0))


def test_the_same_seed_gives_the_same_ticks() -> None:
    first, second = (list(islice(Simulation(HALL, 3), 300)) for _ in range(2))
    assert first == second


def test_each_step_has_the_true_pose_at_its_scan() -> None:
    truths = {tick.laser.stamp_ns: tick.map_from_robot for tick in islice(Simulation(HALL, 1), 200)}
    steps = simulated_steps(Simulation(HALL, 1), BridgeSettings(), steps=20)
    assert all(truth == truths[scan.stamp_ns] for scan, truth in steps)


def test_a_kidnapping_moves_the_robot_far_without_a_jump_of_odometry() -> None:
    simulation = Simulation(HALL, 2)
    before = list(islice(simulation, 100))[-1]
    x, y, _ = simulation.map_from_robot
    where = simulation.kidnap()
    after = next(simulation)
    assert hypot(where[0] - x, where[1] - y) > 5.0
    assert hypot(after.map_from_robot[0] - where[0], after.map_from_robot[1] - where[1]) < 0.1
    jump = np.subtract(after.odometry[0].odom_from_robot, before.odometry[1].odom_from_robot)
    assert hypot(jump[0], jump[1]) < 0.1


def test_a_kidnapped_robot_drives_on_from_the_given_pose_or_next_to_a_wall_that_is_there() -> None:
    simulation = Simulation(world("cross_feature"), 2)
    assert simulation.kidnap((0.0, -3.0, 1.0)) == (0.0, -3.0, 1.0)
    path = np.array([tick.map_from_robot for tick in islice(simulation, 150)])
    assert np.hypot(*(path[0, :2] - [0.0, -3.0])) < 0.1
    assert np.ptp(path[:, :2], axis=0).max() > 1.0
    in_room = Simulation(world_from_map(ROOM), 2)
    assert in_room.kidnap((-0.05, 2.0, 1.0)) == pytest.approx((0.4, 2.0, 1.0), abs=0.2)


def test_a_robot_drives_at_given_rates_hits_no_wall_stands_and_wanders_again() -> None:
    simulation = Simulation(world_from_map(ROOM), 2, start=(1.0, 2.0, 0.0))
    simulation.robot.drive_at(0.6, 0.0)
    x = [tick.map_from_robot[0] for tick in islice(simulation, 30)]
    assert x[10] > x[0] + 0.1
    assert x[-1] == x[-5]  # 3 s later it has stood still for long
    simulation.robot.drive_at(-0.6, 1.0)
    after = list(islice(simulation, 10))[-1].map_from_robot
    assert after[0] < x[-1]
    assert after[2] > 0.3
    free_space = FreeSpace(ROOM)
    for _ in range(20):
        simulation.robot.drive_at(9.0, 0.0)
        for tick in islice(simulation, 10):
            assert free_space.clearance_m(*tick.map_from_robot[:2]) >= robot.RADIUS_M - 0.01
    simulation.robot.wander()
    path = np.array([tick.map_from_robot for tick in islice(simulation, 150)])
    assert np.ptp(path[:, :2], axis=0).max() > 1.0


def test_beams_end_at_the_walls_of_the_true_map() -> None:
    lidar = Lidar(PERFECT, ROOM, np.random.default_rng(0))
    seen = lidar.scan((2.0, 1.0, pi / 2))
    assert seen[[0, 90, 180]] == pytest.approx([4.0, 3.0, 2.0])  # right, ahead, left
    near = Lidar(replace(PERFECT, range_max_m=2.5), ROOM, np.random.default_rng(0))
    assert near.scan((2.0, 1.0, pi / 2))[[0, 90, 180]] == pytest.approx([np.inf, np.inf, 2.0])


def test_noise_and_drop_outs_are_as_frequent_as_configured() -> None:
    model = replace(PERFECT, range_noise_m=0.05, drop_out_share=0.1)
    lidar, clean = (Lidar(m, ROOM, np.random.default_rng(1)) for m in (model, PERFECT))
    pose = (2.0, 1.0, 0.3)
    scans = np.array([lidar.scan(pose) for _ in range(60)])
    lost = np.isinf(scans)
    errors = (scans - clean.scan(pose))[~lost]
    # 10,860 beams: five standard errors of the share are 0.015, of the deviation 0.0018.
    assert lost.mean() == pytest.approx(0.1, abs=0.015)
    assert errors.std() == pytest.approx(0.05, abs=0.0018)


def test_a_robot_follows_a_way_then_turns_round_and_then_wanders() -> None:
    simulation = Simulation(world_from_map(ROOM), 3, start=(1.0, 2.0, 0.0))
    simulation.robot.follow(np.array([(3.5, 2.0), (4.0, 2.0)]))
    while simulation.robot.follows:
        next(simulation)
    assert hypot(simulation.map_from_robot[0] - 4.0, simulation.map_from_robot[1] - 2.0) < 0.45
    simulation.robot.drive_at(0.0, 0.0)
    for _ in range(20):
        next(simulation)
    before = simulation.map_from_robot
    simulation.robot.turn_round()
    turned = 0.0
    while simulation.robot.follows:
        last = simulation.map_from_robot[2]
        next(simulation)
        turned += (simulation.map_from_robot[2] - last) % (2 * pi)
    assert turned == pytest.approx(2 * pi, abs=0.3)
    assert simulation.map_from_robot[:2] == pytest.approx(before[:2], abs=0.05)
    for _ in range(50):
        next(simulation)
    assert simulation.map_from_robot[:2] != pytest.approx(before[:2], abs=0.1)
