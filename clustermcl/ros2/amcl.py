"""AMCL's node without input and output: takes messages, yields outputs. No network, clock, log."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from msgspec.structs import replace

from clustermcl.filter.arrays import OCCUPIED
from clustermcl.filter.poses import compose
from clustermcl.protocol.advice import Advice
from clustermcl.protocol.answers import Belief, Relocalize
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.causes import Cause
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.pose_arrays import pose_tuple
from clustermcl.protocol.reading_checks import pose_problem
from clustermcl.protocol.steps import LaserReading, MapReading, OdometryReading
from clustermcl.protocol.work import Particles
from clustermcl.recordings.headers import frame_name, time_of
from clustermcl.recordings.maps.map_message import grid_map_of
from clustermcl.recordings.rigid import rigid_of
from clustermcl.recordings.transforms import Kept, TransformMissingError, TransformTree
from clustermcl.ros2 import laser_scans, messages_out, observing, topics
from clustermcl.ros2 import message_types as types
from clustermcl.ros2.initial_pose import given_pose, initial_pose
from clustermcl.ros2.message_types import new
from clustermcl.ros2.outputs import NO_ID, SENDER, Output, Publish, Refused
from clustermcl.ros2.particles import ClusterParticles
from clustermcl.ros2.pose_choice import MapFromOdom, PoseChoice, on_floor
from clustermcl.ros2.tf_queue import TfQueue
from clustermcl.ros2.topics import Topic
from clustermcl.runtime.settings import Ros2Settings


class Amcl:
    """Localization node with AMCL's behaviour.

    Each `on_...` method takes one message and yields what the process is to do.
    """

    def __init__(self, settings: Ros2Settings, name: str = "amcl") -> None:
        self.settings, self.name = settings, name
        self.is_active = False
        self.belief: Belief | None = None
        self.last_pose: PoseTuple | None = None
        self._unpublished: Belief | None = None
        self._frames = TransformTree()
        self._waiting = TfQueue()
        self._observing = observing.Observing(self._frames, settings)
        self._place = MapFromOdom()
        self.choice = PoseChoice(settings.publish)
        self._particles = ClusterParticles()
        self._odometry_ns: int | None = None
        self._published_ns: int | None = None
        self._map_digest = ""
        self._floor = ""
        self.waits_for_map = False
        """Whether map_server still has the map of another floor."""
        self._remembered_pose: Any = None
        self._was_reset = False

    def use(self, settings: Ros2Settings) -> None:
        """Change the settings; names of topics and frames stay the same."""
        self.settings = self._observing.settings = settings
        self.choice.publish = settings.publish

    # --- lifecycle

    def activate(self) -> Iterator[Output]:
        """Start, with the pose given while inactive, else with the one in the settings."""
        self.is_active = True
        if self._remembered_pose is not None:
            remembered, self._remembered_pose = self._remembered_pose, None
            yield from self.on_initial_pose(remembered)
        elif self.settings.set_initial_pose:
            yield initial_pose(self.settings)
        elif self._was_reset and self.settings.always_reset_initial_pose:
            yield Relocalize(sender=SENDER, command_id=NO_ID)
        self._was_reset = False

    def resume(self, held: int | None) -> None:
        """Continue in place of a killed bridge, which published the cluster `held` as the pose."""
        self.is_active, self.choice.held = True, held

    def deactivate(self) -> None:
        self.is_active = False
        self._waiting.clear()

    def clean_up(self) -> None:
        """Reset: the next map is treated as new."""
        self._was_reset = True
        self._map_digest = ""

    # --- from ROS

    def on_clock_set_back(self, back_ns: int) -> Iterator[Output]:
        self._frames.forget_moving()
        yield from self._on_set_back(f"/clock goes back by {back_ns / 1e9:.3f} s")

    def on_transforms(self, message: Any, now_ns: int, *, fixed: bool) -> Iterator[Output]:
        """Handle a `tf2_msgs/TFMessage`; `fixed`: it came on `/tf_static`."""
        for one in message.transforms:
            parent, child = frame_name(one.header.frame_id), frame_name(one.child_frame_id)
            if (parent, child) == (self.settings.global_frame, self.settings.odom_frame):
                yield Refused(Cause.OTHER_LOCALIZER, f"{parent!r} -> {child!r} in tf")
                continue
            try:
                link = rigid_of(one.transform.translation, one.transform.rotation)
                stamp_ns = time_of(one.header.stamp)
            except ValueError as problem:
                yield Refused(Cause.TRANSFORM_REFUSED, f"{parent!r} -> {child!r}: {problem}")
                continue
            match self._frames.add(stamp_ns, parent, child, link, fixed=fixed):
                case Kept.NO:
                    yield Refused(Cause.LATE_TRANSFORM, f"{parent!r} -> {child!r} at {stamp_ns} ns")
                case Kept.CLOCK_SET_BACK:
                    yield from self._on_set_back(f"tf from {parent!r} to {child!r} goes back")
        yield from self._odometry()
        yield from self.on_tick(now_ns)

    def on_scan(self, message: Any, now_ns: int) -> Iterator[Output]:
        """Handle a `sensor_msgs/LaserScan`; it may wait for its transforms."""
        if not self.is_active:
            return

        def convert() -> LaserReading:
            return laser_scans.laser_reading(message, self._frames, self.settings)

        laser, most = repr(frame_name(message.header.frame_id)), laser_scans.MAX_WAITING
        yield from self._waiting.add("laser scan", laser, convert, now_ns, most)
        yield from self.on_tick(now_ns)

    def on_map(self, message: Any) -> Iterator[Output]:
        """Handle a `nav_msgs/OccupancyGrid`."""
        if self._map_digest and self.settings.first_map_only:
            return
        frame = frame_name(message.header.frame_id)
        if frame != self.settings.global_frame:
            expected = self.settings.global_frame
            yield Refused(Cause.MAP_OTHER_FRAME, f"{frame!r}, not {expected!r}; used anyway")
        try:
            grid_map = grid_map_of(message)
        except ValueError as problem:
            yield Refused(Cause.MAP_REFUSED, str(problem))
            return
        if grid_map.digest != self._map_digest:
            self._map_digest = grid_map.digest
            for remark in grid_map.remarks:
                yield Refused(Cause.MAP_ODDS, remark)
            occupancy = np.where(grid_map.cells == OCCUPIED, np.int8(100), grid_map.cells)
            yield MapReading(
                sender=SENDER,
                cell_m=grid_map.cell_m,
                map_from_grid=grid_map.map_from_grid,
                occupancy=ArrayBlob.of(occupancy, "int8"),
            )

    def on_initial_pose(self, message: Any) -> Iterator[Output]:
        """Handle a `geometry_msgs/PoseWithCovarianceStamped`; while inactive it is kept."""
        if not self.is_active:
            self._remembered_pose = message
            return
        try:
            given = given_pose(message, self.settings, self._frames)
            yield replace(given, floor=self.choice.floor or self.settings.initial_floor)
        except ValueError as problem:
            yield Refused(Cause.POSE_REFUSED, str(problem))

    def on_observed(self, message: Any, topic: Topic, now_ns: int) -> Iterator[Output]:
        """Handle a message of another sensor, see `Observing`; it may wait for its transforms."""
        if not self.is_active:
            return
        for convert in self._observing.conversions(message, topic):
            most = observing.MAX_WAITING
            yield from self._waiting.add("observation", topic.name, convert, now_ns, most)
        yield from self.on_tick(now_ns)

    # --- from the system

    def on_particles(self, cluster: int, particles: Particles) -> None:
        self._particles.on_particles(cluster, particles)

    def on_belief(self, belief: Belief) -> Iterator[Output]:
        """Handle the belief after a step: publish the pose; `all_places` publishes all places."""
        if self.belief is not None and belief.term < self.belief.term:
            return  # from a coordinator that has been replaced
        self.belief = self._unpublished = belief
        chosen = self.choice.choose(belief, self._place.expected(belief.stamp_ns))
        if chosen is None:
            self._place.forget_place()
        else:
            self._place.on_place(belief.stamp_ns, chosen.pose)
        if not self.is_active:
            return
        stamp_ns, frame = belief.stamp_ns, self.settings.global_frame
        if chosen is not None:
            message = messages_out.pose_stamped(chosen.pose, chosen.covariance, stamp_ns, frame)
            yield Publish(topics.AMCL_POSE, message)
            self.last_pose = chosen.pose
            if chosen.floor != self._floor:
                self._floor = chosen.floor
                yield Publish(topics.FLOOR, new(types.STRING, data=chosen.floor))
        yield Publish(topics.STATE, new(types.STRING, data=belief.state))
        yield Publish(topics.PROBABILITY, new(types.FLOAT64, data=belief.probability))

    def all_places(self, *, with_cloud: bool = True) -> Iterator[Output]:
        """Publish all places of the newest belief, once; this is not urgent."""
        belief, frame = self._unpublished, self.settings.global_frame
        self._unpublished = None
        if belief is None or not self.is_active:
            return
        belief = on_floor(belief, self.choice.floor or belief.floor)
        places = messages_out.detection(belief, frame, self.name)
        yield Publish(topics.HYPOTHESIS_DETECTION, places)
        yield Publish(topics.HYPOTHESES, messages_out.markers(belief, frame))
        if with_cloud and (cloud := self._particles.cloud(belief)) is not None:
            message = messages_out.particle_cloud(*cloud, belief.stamp_ns, frame)
            yield Publish(topics.PARTICLE_CLOUD, message)

    def on_advice(self, advice: Advice) -> Iterator[Output]:
        """Publish the best way in the odometry frame; an empty path if there is none."""
        poses: list[PoseTuple] = []
        if advice.ways:
            ahead = compose(np.array(advice.odom_from_robot), np.array(advice.ways[0].poses))
            poses = list(map(pose_tuple, ahead))
        if advice.note:
            yield Refused(Cause.ADVICE, advice.note)
        path = messages_out.path(poses, advice.stamp_ns, self.settings.odom_frame)
        yield Publish(topics.ADVICE, path)

    # --- helpers

    def _odometry(self) -> Iterator[Output]:
        """Yield the newest odometry, unless it was yielded before."""
        odom, base = self.settings.odom_frame, self.settings.base_frame
        stamp_ns = self._frames.newest_ns(odom, base)
        if stamp_ns is None or (self._odometry_ns is not None and stamp_ns <= self._odometry_ns):
            return
        self._odometry_ns = stamp_ns
        try:
            pose = self._frames.lookup(odom, base, stamp_ns).planar()
        except TransformMissingError:  # one of several links begins later
            return
        if pose_problem(pose):
            yield Refused(Cause.ODOMETRY_REFUSED, f"{pose} is out of range")
            return
        if self._place.on_odometry(stamp_ns, pose):
            self._frames.keep_newest()  # do not interpolate across the jump
            yield Refused(Cause.ODOMETRY_JUMPED, f"to {pose}; map -> odom compensates for it")
        if self.is_active:
            yield OdometryReading(sender=SENDER, stamp_ns=stamp_ns, odom_from_robot=pose)

    def on_tick(self, now_ns: int) -> Iterator[Output]:
        """Use what has its transforms now; refuse what has waited for them too long."""
        for reading in self._waiting.ready(now_ns, self.settings.transform_tolerance_s):
            yield reading
            if not isinstance(reading, LaserReading):
                continue
            assert reading.odom_from_robot is not None  # `laser_reading` looks it up
            self._place.on_scan(reading.stamp_ns, reading.odom_from_robot)
            map_from_odom = self._place.place(reading.odom_from_robot)
            is_newer = self._published_ns is None or reading.stamp_ns > self._published_ns
            is_wanted = self.settings.tf_broadcast and not self.waits_for_map
            if map_from_odom is not None and is_newer and is_wanted:
                self._published_ns = reading.stamp_ns
                until_ns = reading.stamp_ns + round(self.settings.transform_tolerance_s * 1e9)
                names = (self.settings.global_frame, self.settings.odom_frame)
                link = messages_out.transform(map_from_odom, until_ns, *names)
                yield Publish(topics.TF, link)

    def _on_set_back(self, detail: str) -> Iterator[Output]:
        self._waiting.clear()
        self._place.forget_scans()
        self._odometry_ns = self._published_ns = None
        yield Refused(Cause.CLOCK_SET_BACK, detail)
