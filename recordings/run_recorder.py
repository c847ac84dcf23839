"""A run as a rosbag2: what the system saw, and what it believed."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from grid_maps.grid_map import GridMap
from particle_filter.poses import compose, inverse
from protocol.answers import Belief, Hypothesis
from protocol.message import PoseTuple
from protocol.pose_arrays import covariance_matrix, pose_tuple
from protocol.steps import OdometryReading, Scan
from recordings.bag_writer import BagWriter
from recordings.ros_messages import BASE, BELIEF_TOPIC, LASER, MAP, ODOM, RosMessages

CLOUD_POSES = 500


class RunRecorder:
    """Writes a run while it goes on; use it in a ``with`` block.

    Topics: ``/map``, ``/tf`` (odometry, and the map's place above it as believed), ``/tf_static``
    (the laser), ``/scan``, ``/amcl_pose`` (the most probable place), ``/particle_cloud`` (poses
    drawn from the places' Gaussians: workers keep their particles), ``/hypotheses`` as they are
    drawn, and ``/belief``, all of it as JSON.

    Args:
        writer: of the bag.
    """

    def __init__(self, writer: BagWriter) -> None:
        self._writer, self._messages = writer, RosMessages(writer.types)
        self._rng = np.random.default_rng(0)
        self._mounts: dict[str, PoseTuple] = {}
        self._map_digest = ""

    @classmethod
    def to(cls, path: Path) -> "RunRecorder":
        """A recorder that writes a file.

        Raises:
            OutputError: it cannot be written, or the extra ``ros2`` is not installed.
        """
        return cls(BagWriter(path))

    def __enter__(self) -> "RunRecorder":
        return self

    def __exit__(self, *how: object) -> None:
        self._writer.__exit__(*how)

    def wants_map(self, scan: Scan) -> bool:
        """Whether the map of a step has not been told yet."""
        return scan.map_digest != self._map_digest

    def on_map(self, grid_map: GridMap, stamp_ns: int) -> None:
        """Steps are of this map from now on."""
        self._map_digest = grid_map.digest
        self._writer.write("/map", self._messages.map(grid_map, stamp_ns), stamp_ns)

    def on_odometry(self, reading: OdometryReading) -> None:
        """The robot moved."""
        self._link(reading.stamp_ns, ODOM, BASE, reading.odom_from_robot)

    def on_scan(self, scan: Scan) -> None:
        """A step: its scan, and where odometry was then."""
        at_ns = scan.stamp_ns
        self._link(at_ns, ODOM, BASE, scan.odom_from_robot)
        self._mount(at_ns, LASER, scan.robot_from_laser)
        self._writer.write("/scan", self._messages.scan(scan, at_ns, LASER), at_ns)
        for number, other in enumerate(scan.others, start=1):
            frame = f"{LASER}_{number}"
            self._link(at_ns, BASE, frame, other.robot_from_laser)
            self._writer.write("/scan", self._messages.scan(other, at_ns, frame), at_ns)

    def on_belief(self, belief: Belief) -> None:
        """What is believed after a step."""
        messages, write = self._messages, self._writer.write
        stamp_ns, hypotheses = belief.stamp_ns, belief.hypotheses
        if hypotheses:
            best = hypotheses[0]
            there, odometry = np.array(best.mean), np.array(belief.odom_from_robot)
            self._link(stamp_ns, MAP, ODOM, pose_tuple(compose(there, inverse(odometry))))
            pose = messages.pose(best.mean, best.covariance, stamp_ns)
            write("/amcl_pose", pose, stamp_ns)
        write("/particle_cloud", messages.poses(self._cloud(hypotheses), stamp_ns), stamp_ns)
        write("/hypotheses", messages.places(hypotheses, stamp_ns), stamp_ns)
        write(BELIEF_TOPIC, messages.belief(belief), stamp_ns)

    def _cloud(self, hypotheses: Sequence[Hypothesis]) -> list[PoseTuple]:
        poses: list[PoseTuple] = []
        for place in hypotheses:
            count = round(CLOUD_POSES * place.probability)
            variances, axes = np.linalg.eigh(covariance_matrix(place.covariance))
            drawn = self._rng.standard_normal((count, 3)) * np.sqrt(np.maximum(variances, 0.0))
            poses += [pose_tuple(pose) for pose in np.array(place.mean) + drawn @ axes.T]
        return poses

    def _link(self, stamp_ns: int, parent: str, child: str, pose: PoseTuple) -> None:
        self._writer.write(
            "/tf", self._messages.transforms(stamp_ns, (parent, child, pose)), stamp_ns
        )

    def _mount(self, stamp_ns: int, frame: str, robot_from_laser: PoseTuple) -> None:
        """Where a laser sits: once, and again where that has changed."""
        if self._mounts.get(frame) != robot_from_laser:
            self._mounts[frame] = robot_from_laser
            mount = self._messages.transforms(stamp_ns, (BASE, frame, robot_from_laser))
            self._writer.write("/tf_static", mount, stamp_ns)
