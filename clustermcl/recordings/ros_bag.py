"""Reads ROS bags as recordings: laser scans, odometry and the laser's mount.

Odometry comes from tf as in AMCL: the pose of the robot's frame in the frame `odom`. The robot's
frame is the child of `odom` on the way to the laser's frame. If tf has no such frame, odometry
comes from a topic. Nothing is guessed: if there are several candidates, the error requests a name.
"""

import math
from collections.abc import Sequence
from contextlib import closing, suppress
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from clustermcl.filter.motion.trajectory import MAX_EXTRAPOLATION_NS
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.errors import RecordingError
from clustermcl.protocol.steps import MAX_BEAMS, LaserReading
from clustermcl.recordings.bag_file import LASER_SCAN, ODOMETRY, TF_MESSAGE, BagFile, BagMessage
from clustermcl.recordings.headers import frame_name, nanoseconds
from clustermcl.recordings.log_file import SENDER, Entry, SkippedLine, odometry_entry
from clustermcl.recordings.rigid import Rigid, is_upside_down, rigid_of
from clustermcl.recordings.transforms import TransformMissingError, TransformTree
from clustermcl.runtime.settings import BridgeSettings

ODOM_FRAME = "odom"
"""ROS's name for the frame of odometry (REP 105), and AMCL's default."""
_SAME = 1e-6
"""Largest difference [m, and in the quaternion] between the poses of a fixed link."""


def bag_entries(path: Path, settings: BridgeSettings) -> tuple[list[Entry], list[SkippedLine]]:
    """Return the entries of a bag in the order of recording, and the skipped messages.

    Raises:
        RecordingError: the bag cannot be read, has no scan, has several candidates for a topic or
            frame that the settings do not name, or lacks a transform.
    """
    with closing(BagFile(path, RecordingError)) as bag:
        try:
            content = _Content(bag, settings)
            return content.entries(), content.skipped
        except ValueError as problem:
            raise RecordingError(path, str(problem)) from problem


class _Sent(NamedTuple):
    number: int
    time_ns: int
    stamp_ns: int
    parent_from_child: Rigid
    fixed: bool

    def is_same(self, other: "_Sent") -> bool:
        moved = self.parent_from_child.inverse().of(other.parent_from_child)
        return max(map(abs, moved[:6])) < _SAME


_Sorted = tuple[int, int, Entry]
"""Time of recording [ns], rank of the sensor at equal times, entry."""


class _Content:
    """The scans, odometry and transforms of a bag; a problem is a `ValueError`."""

    def __init__(self, bag: BagFile, settings: BridgeSettings) -> None:
        self._settings, self.skipped = settings, bag.left_out
        scan_topic = _one_of(bag, LASER_SCAN, settings.scan_topic, "scan_topic")
        self._odom_topics = [] if settings.odom_frame else bag.of_type(ODOMETRY)  # if tf has none
        if settings.odom_topic:
            self._odom_topics = [_one_of(bag, ODOMETRY, settings.odom_topic, "odom_topic")]
        self._scans: list[BagMessage] = []
        self._poses: list[BagMessage] = []
        self._links: dict[tuple[str, str], list[_Sent]] = {}
        """Transforms by parent and child."""
        for message in bag.messages({scan_topic, *_tf_topics(bag, scan_topic), *self._odom_topics}):
            match bag.topics[message.topic]:
                case kind if kind == LASER_SCAN:
                    if (beams := len(message.content.ranges)) <= MAX_BEAMS:
                        self._scans.append(message)
                        continue
                    problem = f"a scan of {beams} beams; at most {MAX_BEAMS} are read"
                    self.skipped.append(SkippedLine(message.number, problem))
                case kind if kind == ODOMETRY:
                    self._poses.append(message)
                case _:
                    self._add_links(message)
        self._tree = TransformTree(cache_ns=None, slack_ns=MAX_EXTRAPOLATION_NS)
        for (parent, child), sent in self._links.items():
            # A link that never moves counts as fixed.
            fixed = sent[-1].fixed or all(one.is_same(sent[0]) for one in sent)
            for one in sent[-1:] if fixed else sent:
                self._tree.add(one.stamp_ns, parent, child, one.parent_from_child, fixed=fixed)

    def _add_links(self, message: BagMessage) -> None:
        fixed = message.topic.endswith("tf_static")
        for link in message.content.transforms:
            parent, child = frame_name(link.header.frame_id), frame_name(link.child_frame_id)
            try:
                there = rigid_of(link.transform.translation, link.transform.rotation)
            except ValueError as error:
                problem = f"from {parent!r} to {child!r} tf has {error}"
                self.skipped.append(SkippedLine(message.number, problem))
                continue
            stamp_ns = nanoseconds(link.header.stamp)
            sent = _Sent(message.number, message.time_ns, stamp_ns, there, fixed)
            self._links.setdefault((parent, child), []).append(sent)

    def entries(self) -> list[Entry]:
        if not self._scans:
            why = f": {self.skipped[0].problem}" if self.skipped else ""
            raise ValueError(f"no scan in it can be read{why}")
        frames = list(dict.fromkeys(map(_frame_of, self._scans)))
        base, entries = self._odometry(frames)
        problems: list[SkippedLine] = []
        for scan in self._scans:
            try:
                entries.append((scan.time_ns, 1, self._laser_entry(scan, base)))
            except ValueError as error:
                problems.append(SkippedLine(scan.number, str(error)))
        if len(problems) == len(self._scans):
            raise ValueError(problems[0].problem)
        self.skipped += problems
        return [entry for _, _, entry in sorted(entries, key=lambda one: one[:2])]

    def _odometry(self, frames: Sequence[str]) -> tuple[str, list[_Sorted]]:
        """Return the robot's frame, and the odometry entries."""
        if self._settings.odom_topic:
            return self._topic_odometry()
        ways = map(self._tree.way_up, frames)
        way = next((way for way in ways if len(way) > 1), list(frames[:1]))
        self._refuse_two_parents(way)
        odom_frame = self._settings.odom_frame or ODOM_FRAME
        if odom_frame in way[1:]:
            base = self._settings.base_frame or way[way.index(odom_frame) - 1]
            return base, self._tf_odometry(odom_frame, base)
        if len(self._odom_topics) == 1:
            return self._topic_odometry()
        if self._odom_topics:
            held = f"{len(self._odom_topics)} topics of odometry: {', '.join(self._odom_topics)}"
            above = f"tf has no frame {odom_frame!r} above the laser's and there are {held}"
            raise ValueError(f"{above}; {_by_name('odom_topic')}")
        if len(way) == 1 and any(parent == odom_frame for parent, _ in self._links):
            problem = f"no transform of the laser's frame {way[0]!r}; tf has {self._tree}"
            raise ValueError(f"{problem}: record /tf_static, too")
        above = f"above the laser's frame tf has {' <- '.join(reversed(way))}"
        problem = f"no odometry: {above}, without {odom_frame!r}; {_by_name('odom_frame')}"
        raise ValueError(f"{problem}; tf holds {self._tree}")

    def _topic_odometry(self) -> tuple[str, list[_Sorted]]:
        bases = sorted({frame_name(one.content.child_frame_id) for one in self._poses})
        base = self._settings.base_frame or (bases[0] if len(bases) == 1 else "")
        if not base:
            raise ValueError(f"odometry is of the frames {bases}; {_by_name('base_frame')}")
        found: list[_Sorted] = []
        for one in self._poses:
            stamp_ns, pose = nanoseconds(one.content.header.stamp), one.content.pose.pose
            x, y, z, w = (getattr(pose.orientation, axis) for axis in "xyzw")
            heading = math.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)
            at = (pose.position.x, pose.position.y, heading)
            found.append((one.time_ns, 0, odometry_entry(one.number, stamp_ns, at)))
        return base, found

    def _tf_odometry(self, odom_frame: str, base: str) -> list[_Sorted]:
        """Return the robot's pose at each transform of the uppermost moving link."""
        way = self._tree.way_up(base, to=odom_frame)
        if way[-1] != odom_frame or len(way) == 1:
            raise ValueError(f"no transform from {odom_frame!r} to {base!r}; tf has {self._tree}")
        self._refuse_two_parents(way)
        links = [(parent, child) for child, parent in pairwise(way)]
        moving = [link for link in links if self._tree.moves(link[1])]
        found: list[_Sorted] = []
        for at in self._links[(moving or links)[-1]]:
            with suppress(TransformMissingError):  # another link begins later or ends earlier
                pose = self._tree.lookup(odom_frame, base, at.stamp_ns).planar()
                found.append((at.time_ns, 0, odometry_entry(at.number, at.stamp_ns, pose)))
        return found

    def _refuse_two_parents(self, way: Sequence[str]) -> None:
        for frame in way[:-1]:
            parents = sorted(parent for parent, child in self._links if child == frame)
            if len(parents) > 1:
                named = " and ".join(parents)
                raise ValueError(f"tf gives the frame {frame!r} {len(parents)} parents: {named}")

    def _laser_entry(self, message: BagMessage, base: str) -> Entry:
        scan, frame = message.content, _frame_of(message)
        stamp_ns, upside_down = nanoseconds(scan.header.stamp), False
        given = self._settings
        mount = given.laser_x_m, given.laser_y_m, given.laser_heading_rad
        if frame == base or self._tree.knows(frame):
            self._refuse_two_parents(self._tree.way_up(frame, to=base))
            base_from_laser = self._tree.lookup(base, frame, stamp_ns)
            mount = base_from_laser.planar()
            upside_down = is_upside_down(frame, base_from_laser)
        elif not any(mount):
            raise ValueError(
                f"no transform from {base!r} to the laser's frame {frame!r}; tf has {self._tree}; "
                "say where the laser is by bridge.laser_x_m, laser_y_m and laser_heading_rad"
            )
        limit = float(scan.range_max)
        ranges = np.array(scan.ranges, np.float32)
        with np.errstate(invalid="ignore"):
            ranges[ranges < scan.range_min] = 0.0
        reading = LaserReading(
            sender=SENDER,
            stamp_ns=stamp_ns,
            ranges=ArrayBlob.of(ranges, "float32"),
            angle_min_rad=float(scan.angle_min),
            angle_step_rad=float(scan.angle_increment),
            range_max_m=limit if limit > 0.0 else math.inf,
            robot_from_laser=mount,
            laser=frame,
            upside_down=upside_down,
        )
        return Entry(message.number, reading)


def _one_of(bag: BagFile, message_type: str, named: str, setting: str) -> str:
    """Return the named topic, or if the name is empty the only topic of a type."""
    topics, short = bag.of_type(message_type), message_type.replace("/msg/", "/")
    if named in topics:
        return named
    if len(topics) == 1 and not named:
        return topics[0]
    held = ", ".join(topics or sorted(bag.topics)) or "nothing"
    problem = f"no {short} on {named}" if named else f"{len(topics)} topics of {short}"
    raise ValueError(f"{problem}; the bag has {held}; {_by_name(setting)}")


def _by_name(setting: str) -> str:
    return f"name one by --{setting.replace('_', '-')} (bridge.{setting})"


def _tf_topics(bag: BagFile, scan_topic: str) -> list[str]:
    """Return the tf topics in the nearest namespace at or above that of the scan topic."""
    topics = bag.of_type(TF_MESSAGE)
    namespaces = {topic.rpartition("/")[0] for topic in topics}
    if len(namespaces) <= 1:
        return topics
    above = scan_topic.rpartition("/")[0]
    while above and above not in namespaces:
        above = above.rpartition("/")[0]
    if above not in namespaces:
        raise ValueError(f"several robots' tf ({', '.join(topics)}), none above {scan_topic}")
    return [topic for topic in topics if topic.rpartition("/")[0] == above]


def _frame_of(scan: BagMessage) -> str:
    return frame_name(scan.content.header.frame_id)
