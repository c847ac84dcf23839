import itertools
from collections.abc import Iterator

import msgspec
import numpy as np
import pytest

from clustermcl.evaluation.map_check.agreement import Agreement, agreement_of
from clustermcl.evaluation.map_check.mount import mount_of
from clustermcl.evaluation.map_check.report import report_of
from clustermcl.filter.poses import compose
from clustermcl.filter.settings import FilterSettings
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import Reading, Scan, mirrored
from clustermcl.runtime.settings import BridgeSettings
from clustermcl.sensor_bridge.step_maker import StepMaker
from clustermcl.simulator.sensors import LidarModel
from clustermcl.simulator.simulation import Simulation, simulated_steps
from clustermcl.simulator.worlds.catalogue import world

MOUNT = (0.3, -0.1, 0.2)


def wandering(steps: int, rng: np.random.Generator) -> np.ndarray:
    """(N, 3) true poses of a robot that drives and turns."""
    poses = [np.zeros(3)]
    for _ in range(steps):
        step = np.array([0.2, 0.0, rng.normal(0.0, 0.2)])
        poses.append(compose(poses[-1], step))
    return np.array(poses)


def with_odometry_errors(poses: np.ndarray, distance: float, turn: float) -> np.ndarray:
    drifted = [np.zeros(3)]
    for before, after in itertools.pairwise(poses):
        turned = after[2] - before[2]
        drift = np.array([0.2 * distance, 0.0, (turned + np.pi) % (2 * np.pi) - np.pi])
        drifted.append(compose(drifted[-1], drift * (1.0, 1.0, turn)))
    return np.array(drifted)


def test_the_mount_and_the_scales_of_odometry_are_found() -> None:
    rng = np.random.default_rng(0)
    poses = wandering(200, rng)
    laser = compose(poses, np.array(MOUNT)) + rng.normal(0.0, 0.01, poses.shape)
    found = mount_of(laser, with_odometry_errors(poses, distance=1.04, turn=0.97))
    assert found is not None
    assert found.robot_from_laser == pytest.approx(MOUNT, abs=0.03)
    assert found.odometry_distance_scale == pytest.approx(1.04, abs=0.01)
    assert found.odometry_turn_scale == pytest.approx(0.97, abs=0.01)
    assert max(found.standard_errors) < 0.03


def test_a_robot_that_never_turns_reveals_nothing_of_its_laser() -> None:
    straight = np.column_stack([np.arange(100) * 0.2, np.zeros(100), np.zeros(100)])
    assert mount_of(straight, straight) is None
    assert mount_of(straight[:6], straight[:6]) is None


def test_on_a_circle_the_error_of_the_scale_is_large_and_no_alarm() -> None:
    """The laser's y and the scale of distances are one unknown there."""
    rng = np.random.default_rng(3)
    poses = [np.zeros(3)]
    for _ in range(60):
        poses.append(compose(poses[-1], np.array([0.2, 0.0, 0.12])))
    truth = np.array(poses)
    laser = compose(truth, np.array(MOUNT)) + rng.normal(0.0, 0.004, truth.shape)
    found = mount_of(laser, truth)
    assert found is not None
    assert abs(found.odometry_distance_scale - 1.0) < 3.0 * found.scale_errors[0]
    assert found.scale_errors[0] > 3.0 * found.scale_errors[1]
    far_off = msgspec.structs.replace(found, odometry_distance_scale=0.88, odometry_turn_scale=1.2)
    told = [remark for remark in remarks(agreed(mount=far_off)) if "odometry" in remark]
    assert told == ["odometry turns 20% too much"]


def agreed(**change: object) -> Agreement:
    usual = Agreement(
        steps=100, localized_share=1.0, fitting_share=0.95, recorded_mount=MOUNT, mount=None,
        off_map_probability=0.0, decoy_localized_share=0.0,
    )  # fmt: skip
    return msgspec.structs.replace(usual, **change)


def test_a_laser_that_sees_its_own_robot_and_one_at_another_height_are_named() -> None:
    other = (0.5, 0.0, 0.0)
    seen, fits = remarks(
        agreed(own_robot="80 of 360 beams", fitting_by_mount=((MOUNT, 0.95), (other, 0.4)))
    )
    assert "80 of 360 beams" in seen
    assert "bridge.min_range_m" in seen
    assert fits.startswith("of the laser 0.50 m ahead, 0.00 m left, 0 deg, 40% of the beams end")
    assert "another height" in fits


@pytest.mark.parametrize("late_s", [0.0, 0.3])
def test_a_late_clock_of_the_laser_is_estimated_from_turns(late_s: float) -> None:
    hall, late_ns = world("hall"), round(late_s * 1e9)
    readings: list[Reading] = []
    for tick in itertools.islice(Simulation(hall, 0), 600):
        readings += tick.odometry
        readings.append(msgspec.structs.replace(tick.laser, stamp_ns=tick.laser.stamp_ns + late_ns))
    readings.sort(key=lambda reading: reading.stamp_ns)
    steps = StepMaker(BridgeSettings(), hall.map.digest, "test").all_steps(readings)
    agreement = agreement_of(itertools.islice(steps, 120), hall.map, FilterSettings(), readings)
    assert agreement.lag is not None
    assert agreement.lag.lag_s == pytest.approx(late_s, abs=0.03)
    told = [remark for remark in remarks(agreement) if "stamps" in remark]
    assert len(told) == (late_s > 0.0)
    assert all(f"{agreement.lag.lag_s:.2f} s late" in remark for remark in told)


def recorded(robot_from_laser: PoseTuple) -> Iterator[Scan]:
    """A robot in the hall whose laser is at MOUNT and is recorded at another pose."""
    hall = world("hall")
    robot = Simulation(hall, 0, lidar=LidarModel(robot_from_laser=MOUNT))
    for scan, _ in simulated_steps(robot, BridgeSettings(), steps=60):
        yield msgspec.structs.replace(scan, robot_from_laser=robot_from_laser)


def remarks(agreement: Agreement) -> tuple[str, ...]:
    plan = world("hall").map
    return report_of(
        "hall", plan, laser_range_m=12.0, places=1, seed=1, agreement=agreement
    ).remarks


def test_a_laser_that_sits_elsewhere_is_noticed() -> None:
    plan, settings = world("hall").map, FilterSettings()
    right = agreement_of(recorded(MOUNT), plan, settings)
    assert right.steps == 60
    assert right.localized_share > 0.5
    assert right.fitting_share is not None
    assert right.fitting_share > 0.95
    assert right.decoy_localized_share <= 0.02
    assert remarks(right) == ()
    wrong = agreement_of(recorded((0.0, 0.0, 0.0)), plan, settings)
    (remark,) = remarks(wrong)
    assert remark.startswith(
        "the laser's mount is given as 0.00 m ahead, 0.00 m left, 0 deg, the map"
    )


def test_a_recording_of_another_building_is_noticed() -> None:
    cross = world("cross_feature").map
    agreement = agreement_of(itertools.islice(recorded(MOUNT), 30), cross, FilterSettings())
    assert agreement.is_of_another_map
    assert any("probably not on this map" in remark for remark in remarks(agreement))


def test_a_laser_that_is_upside_down_is_noticed() -> None:
    plan = world("hall").map
    some = itertools.islice(map(mirrored, recorded(MOUNT)), 30)
    agreement = agreement_of(some, plan, FilterSettings())
    assert agreement.decoy_localized_share > 0.9
    assert any("upside down" in remark for remark in remarks(agreement))


def test_a_map_that_is_its_own_mirror_image_is_noticed() -> None:
    alike = agreed(decoy_localized_share=0.8)
    assert any("its own mirror image" in remark for remark in remarks(alike))
