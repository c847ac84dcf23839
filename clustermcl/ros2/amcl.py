"""What AMCL's node does with messages and beliefs. No network, clock or log of its own."""

from functools import partial
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
from clustermcl.ros2 import message_types as types
from clustermcl.ros2 import messages_in, messages_out, topics
from clustermcl.ros2.message_types import new
from clustermcl.ros2.pose_choice import MapFromOdom, PoseChoice, on_floor
from clustermcl.ros2.sides import NO_ID, SENDER, Engine, Ros
from clustermcl.ros2.tf_queue import TfQueue
from clustermcl.ros2.topics import Topic
from clustermcl.runtime.settings import Ros2Settings


class Amcl:
    """Localization node with AMCL's behaviour. Each `on_...` method takes one message or event."""

    def __init__(self, settings: Ros2Settings, ros: Ros, engine: Engine, name: str) -> None:
        self.settings, self._ros, self._engine, self._name = settings, ros, engine, name
        self.is_active = False
        self.belief: Belief | None = None
        self.last_pose: PoseTuple | None = None
        self._unpublished: Belief | None = None
        self._frames = TransformTree()
        self._waiting = TfQueue(ros.refuse)
        self._in = messages_in.MessagesIn(self._frames, settings)
        self._place = MapFromOdom()
        self.choice = PoseChoice(settings.publish)
        self._particles: dict[int, Particles] = {}
        """The newest of each cluster; workers report them every tenth step."""
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
        self.settings = self._in.settings = settings
        self.choice.publish = settings.publish

    # --- lifecycle

    def activate(self) -> None:
        """Start, with the pose given while inactive, else with the one in the settings."""
        self.is_active = True
        if self._remembered_pose is not None:
            remembered, self._remembered_pose = self._remembered_pose, None
            self.on_initial_pose(remembered)
        elif self.settings.set_initial_pose:
            self._engine.command(messages_in.initial_pose(self.settings))
        elif self._was_reset and self.settings.always_reset_initial_pose:
            self._engine.command(Relocalize(sender=SENDER, command_id=NO_ID))
        self._was_reset = False

    def deactivate(self) -> None:
        self.is_active = False
        self._waiting.clear()

    def clean_up(self) -> None:
        """Reset: the next map is treated as new."""
        self._was_reset = True
        self._map_digest = ""

    # --- from ROS

    def on_clock_set_back(self, back_ns: int) -> None:
        self._frames.forget_moving()
        self._on_set_back(f"/clock goes back by {back_ns / 1e9:.3f} s")

    def on_transforms(self, message: Any, *, fixed: bool) -> None:
        """Handle a `tf2_msgs/TFMessage`; `fixed`: it came on `/tf_static`."""
        for one in message.transforms:
            parent, child = frame_name(one.header.frame_id), frame_name(one.child_frame_id)
            if (parent, child) == (self.settings.global_frame, self.settings.odom_frame):
                self._ros.refuse(Cause.OTHER_LOCALIZER, f"{parent!r} -> {child!r} in tf")
                continue
            try:
                link = rigid_of(one.transform.translation, one.transform.rotation)
                stamp_ns = time_of(one.header.stamp)
            except ValueError as problem:
                self._ros.refuse(Cause.TRANSFORM_REFUSED, f"{parent!r} -> {child!r}: {problem}")
                continue
            match self._frames.add(stamp_ns, parent, child, link, fixed=fixed):
                case Kept.NO:
                    late = f"{parent!r} -> {child!r} at {stamp_ns} ns"
                    self._ros.refuse(Cause.LATE_TRANSFORM, late)
                case Kept.CLOCK_SET_BACK:
                    self._on_set_back(f"tf from {parent!r} to {child!r} goes back")
        self._send_odometry()
        self.use_waiting()

    def on_scan(self, message: Any) -> None:
        """Handle a `sensor_msgs/LaserScan`; it may wait for its transforms."""
        if not self.is_active:
            return
        laser, most = repr(frame_name(message.header.frame_id)), messages_in.MOST_SCANS
        convert = partial(self._in.laser_reading, message)
        self._waiting.add("laser scan", laser, convert, self._ros.monotonic_ns(), most)
        self.use_waiting()

    def on_map(self, message: Any) -> None:
        """Handle a `nav_msgs/OccupancyGrid`."""
        if self._map_digest and self.settings.first_map_only:
            return
        frame, expected = frame_name(message.header.frame_id), self.settings.global_frame
        if frame != expected:
            self._ros.refuse(Cause.MAP_OTHER_FRAME, f"{frame!r}, not {expected!r}; used anyway")
        try:
            grid_map = grid_map_of(message)
        except ValueError as problem:
            self._ros.refuse(Cause.MAP_REFUSED, str(problem))
            return
        if grid_map.digest != self._map_digest:
            self._map_digest = grid_map.digest
            for remark in grid_map.remarks:
                self._ros.refuse(Cause.MAP_ODDS, remark)
            occupancy = np.where(grid_map.cells == OCCUPIED, np.int8(100), grid_map.cells)
            reading = MapReading(
                sender=SENDER,
                cell_m=grid_map.cell_m,
                map_from_grid=grid_map.map_from_grid,
                occupancy=ArrayBlob.of(occupancy, "int8"),
            )
            self._engine.put(reading)

    def on_initial_pose(self, message: Any) -> None:
        """Handle a `geometry_msgs/PoseWithCovarianceStamped`; while inactive it is kept."""
        try:
            given = self._in.given_pose(message)
        except ValueError as problem:
            self._ros.refuse(Cause.POSE_REFUSED, str(problem))
            return
        if not self.is_active:
            self._remembered_pose = message
            return
        floor = self.choice.floor or self.settings.initial_floor
        self._engine.command(replace(given, floor=floor))

    def on_observed(self, message: Any, topic: Topic) -> None:
        """Handle a pose by another sensor, or tags; it may wait for its transforms."""
        if not self.is_active:
            return
        most, now_ns = messages_in.MOST_OBSERVATIONS, self._ros.monotonic_ns()
        for convert in self._in.observations(message, topic):
            self._waiting.add("observation", topic.name, convert, now_ns, most)
        self.use_waiting()

    # --- from the engine

    def on_new_map(self) -> None:
        """End the held cluster: another one may have its number in the new map."""
        if self.choice.held is not None:
            self.choice.held = -1

    def on_particles(self, cluster: int, particles: Particles) -> None:
        self._particles[cluster] = particles

    def on_belief(self, belief: Belief) -> None:
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
            self._ros.publish(topics.AMCL_POSE, message)
            self.last_pose = chosen.pose
            if chosen.floor != self._floor:
                self._floor = chosen.floor
                self._ros.publish(topics.FLOOR, new(types.STRING, data=chosen.floor))
        self._ros.publish(topics.STATE, new(types.STRING, data=belief.state))
        self._ros.publish(topics.PROBABILITY, new(types.FLOAT64, data=belief.probability))

    def all_places(self) -> None:
        """Publish all places of the newest belief, once; this is not urgent."""
        belief, frame = self._unpublished, self.settings.global_frame
        self._unpublished = None
        if belief is None or not self.is_active:
            return
        belief = on_floor(belief, self.choice.floor or belief.floor)
        places = messages_out.detection(belief, frame, self._name)
        self._ros.publish(topics.HYPOTHESIS_DETECTION, places)
        self._ros.publish(topics.HYPOTHESES, messages_out.markers(belief, frame))
        kept = {one.cluster for one in belief.hypotheses} & self._particles.keys()
        self._particles = {cluster: self._particles[cluster] for cluster in kept}
        is_heard = self._ros.is_heard(topics.PARTICLE_CLOUD)
        if is_heard and (cloud := messages_out.mixed(belief, self._particles)) is not None:
            message = messages_out.particle_cloud(*cloud, belief.stamp_ns, frame)
            self._ros.publish(topics.PARTICLE_CLOUD, message)

    def on_advice(self, advice: Advice) -> None:
        """Publish the best way in the odometry frame; an empty path if there is none."""
        poses: list[PoseTuple] = []
        if advice.ways:
            ahead = compose(np.array(advice.odom_from_robot), np.array(advice.ways[0].poses))
            poses = list(map(pose_tuple, ahead))
        if advice.note:
            self._ros.refuse(Cause.ADVICE, advice.note)
        path = messages_out.path(poses, advice.stamp_ns, self.settings.odom_frame)
        self._ros.publish(topics.ADVICE, path)

    # --- helpers

    def _send_odometry(self) -> None:
        """Send the newest odometry, unless it was sent before."""
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
            self._ros.refuse(Cause.ODOMETRY_REFUSED, f"{pose} is out of range")
            return
        if self._place.on_odometry(stamp_ns, pose):
            self._frames.keep_newest()  # do not interpolate across the jump
            jump = f"to {pose}; map -> odom compensates for it"
            self._ros.refuse(Cause.ODOMETRY_JUMPED, jump)
        if self.is_active:
            reading = OdometryReading(sender=SENDER, stamp_ns=stamp_ns, odom_from_robot=pose)
            self._engine.put(reading)

    def use_waiting(self) -> None:
        """Use what has its transforms now; refuse what has waited for them too long."""
        tolerance_s = self.settings.transform_tolerance_s
        for reading in self._waiting.ready(self._ros.monotonic_ns(), tolerance_s):
            if not isinstance(reading, LaserReading):
                floor = "" if reading.landmark else self.choice.floor
                self._engine.put(replace(reading, floor=floor))
                continue
            self._engine.put(reading)
            assert reading.odom_from_robot is not None  # `laser_reading` looks it up
            self._place.on_scan(reading.stamp_ns, reading.odom_from_robot)
            map_from_odom = self._place.place(reading.odom_from_robot)
            is_newer = self._published_ns is None or reading.stamp_ns > self._published_ns
            is_wanted = self.settings.tf_broadcast and not self.waits_for_map
            if map_from_odom is not None and is_newer and is_wanted:
                self._published_ns = reading.stamp_ns
                until_ns = reading.stamp_ns + round(tolerance_s * 1e9)
                names = (self.settings.global_frame, self.settings.odom_frame)
                link = messages_out.transform(map_from_odom, until_ns, *names)
                self._ros.publish(topics.TF, link)

    def _on_set_back(self, detail: str) -> None:
        self._waiting.clear()
        self._place.forget_scans()
        self._odometry_ns = self._published_ns = None
        self._ros.refuse(Cause.CLOCK_SET_BACK, detail)
