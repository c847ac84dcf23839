"""A power cut: the last pose is on disk, and is one hypothesis of the next life."""

import math
from pathlib import Path

import msgspec

from coordinator import last_pose_files
from coordinator.pose.last_pose import LastPose
from process_runtime.settings import BridgeSettings, CoordinatorSettings, Settings
from tests.integration.faults.system import SMALL, System, system
from tests.integration.waiting import wait_until
from tests.integration.worlds import world_of

WORLD = "sim:cross_feature"


def kept_in(folder: Path) -> Settings:
    return msgspec.structs.replace(
        SMALL,
        bridge=BridgeSettings(source=WORLD, rate=0.0),
        coordinator=CoordinatorSettings(
            paced_deadline_s=60.0, state_folder=str(folder), save_pose_every_s=0.1
        ),
    )


def kept(folder: Path) -> LastPose | None:
    return next(iter(last_pose_files.read_all(folder, "robot").values()), None)


def cut_the_power(tested: System) -> None:
    for name in tested.stack.pids():
        tested.hurt(name)


def test_where_it_was_sure_to_be_survives_a_power_cut(tmp_path: Path) -> None:
    with system(kept_in(tmp_path), "--steps", "400") as tested:
        wait_until(lambda: any(b.state == "localized" for b in tested.beliefs), 90.0)
        tested.wait_for_steps(5)
        wait_until(lambda: kept(tmp_path) is not None)
        cut_the_power(tested)
        pose = kept(tmp_path)
        assert pose is not None
        assert pose.map_digest == world_of(kept_in(tmp_path)).map.digest
        sure = [b for b in tested.beliefs if b.state == "localized"]
        assert any(
            b.stamp_ns == pose.stamp_ns
            and b.odom_from_robot == pose.odom_from_robot
            and b.hypotheses[0].mean == pose.map_from_robot
            for b in sure
        )


def test_it_is_one_hypothesis_of_the_next_life_and_not_the_truth(tmp_path: Path) -> None:
    digest = world_of(kept_in(tmp_path)).map.digest
    there = (1.5, 1.5, 2.5)  # where the robot is not
    pose = LastPose(
        map_digest=digest,
        stamp_ns=0,
        odom_from_robot=(9.0, 9.0, 0.0),
        map_from_robot=there,
        covariance=(0.01, 0.0, 0.0, 0.0, 0.01, 0.0, 0.0, 0.0, 0.01),
        probability=0.99,
    )
    other_map = msgspec.structs.replace(pose, map_digest="0" * 64, map_from_robot=(0.0, 0.0, 0.0))
    for one in (pose, other_map):
        last_pose_files.write(tmp_path, "robot", one)
    broken = last_pose_files.file_of(tmp_path, "robot", "1" * 64)
    broken.write_bytes(b"{")
    with system(kept_in(tmp_path), "--steps", "40") as tested:
        wait_until(lambda: any(b.state != "searching" for b in tested.beliefs), 90.0)
        tested.wait_for_steps(1)
        first = next(b for b in tested.beliefs if b.state != "searching")
        oldest = max(first.hypotheses, key=lambda h: h.cluster)
        assert math.isclose(oldest.probability, 0.1, abs_tol=0.02)
        here = math.fsum(h.probability for h in first.hypotheses)
        assert math.isclose(here + first.elsewhere_probability, 1.0)
        assert not any(b.state == "localized" for b in tested.beliefs if b.step <= first.step)
        assert all(b.missing == () for b in tested.beliefs)
        assert f"{broken} is no last pose and is ignored" in tested.log("coordinator")
