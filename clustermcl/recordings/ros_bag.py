"""Reads ROS bags as recordings: laser scans, odometry and the laser's mount.

Odometry comes from tf as in AMCL: the pose of the robot's frame in the frame `odom`. The robot's
frame is the child of `odom` on the way to the laser's frame. If tf has no such frame, odometry
comes from a topic. Nothing is guessed: if there are several candidates, the error requests a name.
"""

import math
from collections.abc import Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from clustermcl.filter.motion.trajectory import MAX_EXTRAPOLATION_NS
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.errors import RecordingError
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import MAX_BEAMS, LaserReading, OdometryReading
from clustermcl.recordings.bag_file import LASER_SCAN, ODOMETRY, TF_MESSAGE, BagFile, BagMessage
from clustermcl.recordings.headers import frame_name, nanoseconds
from clustermcl.recordings.laser_mount import is_upside_down
from clustermcl.recordings.log_file import SENDER, Entry, SkippedLine
from clustermcl.recordings.rigid import Rigid, rigid_of
from clustermcl.recordings.transforms import TransformMissingError, TransformTree
from clustermcl.runtime.settings import BridgeSettings

ODOM_FRAME = "odom"
"""ROS's name for the frame of odometry (REP 105), and AMCL's default."""

_SAME = 1e-6
"""Largest difference [m, and in the quaternion] between the poses of a fixed link."""


@dataclass(frozen=True)
class _Transform:
    number: int
    time_ns: int
    stamp_ns: int
    parent: str
    child: str
    parent_from_child: Rigid
    fixed: bool

    def is_same(self, other: "_Transform") -> bool:
        moved = self.parent_from_child.inverse().of(other.parent_from_child)
        return max(map(abs, moved[:6])) < _SAME


@dataclass
class _Content:
    scans: list[BagMessage] = field(default_factory=list)
    poses: list[BagMessage] = field(default_factory=list)
    transforms: list[_Transform] = field(default_factory=list)
    skipped: list[SkippedLine] = field(default_factory=list)

    def frames(self) -> list[str]:
        return list(dict.fromkeys(_frame_of(scan) for scan in self.scans))


def bag_entries(path: Path, settings: BridgeSettings) -> tuple[list[Entry], list[SkippedLine]]:
    """Return the entries of a bag in the order of recording, and the skipped messages.

    Raises:
        RecordingError: the bag cannot be read, has no scan, has several candidates for a topic or
            frame that the settings do not name, or lacks a transform.
    """
    with closing(BagFile(path, RecordingError)) as bag:
        try:
            scan_topic = _one_of(bag, LASER_SCAN, settings.scan_topic, "scan_topic")
            odom_topics = [] if settings.odom_frame else bag.of_type(ODOMETRY)  # if tf has none
            if settings.odom_topic:
                odom_topics = [_one_of(bag, ODOMETRY, settings.odom_topic, "odom_topic")]
            content = _content(bag, {scan_topic, *_tf_topics(bag, scan_topic), *odom_topics})
            return _entries(content, odom_topics, settings), content.skipped
        except ValueError as problem:
            raise RecordingError(path, str(problem)) from problem


def _one_of(bag: BagFile, message_type: str, named: str, setting: str) -> str:
    """Return the named topic, or if the name is empty the only topic of a type."""
    topics = bag.of_type(message_type)
    held = ", ".join(topics) or "none"
    if named in topics:
        return named
    short = message_type.replace("/msg/", "/")
    if named:
        raise ValueError(f"no {short} on {named}; the bag has {held}: {_by_name(setting)}")
    if len(topics) == 1:
        return topics[0]
    if not topics:
        others = ", ".join(sorted(bag.topics)) or "nothing"
        raise ValueError(f"no {short} in it; the bag has {others}")
    raise ValueError(f"{len(topics)} topics of {short}: {held}; {_by_name(setting)}")


def _by_name(setting: str) -> str:
    return f"name one by --{setting.replace('_', '-')} (bridge.{setting})"


def _tf_topics(bag: BagFile, scan_topic: str) -> list[str]:
    """Return the tf topics in the nearest namespace at or above that of the scan topic."""
    topics = bag.of_type(TF_MESSAGE)
    namespaces = {topic.rpartition("/")[0] for topic in topics}
    above = scan_topic.rpartition("/")[0]
    while above and above not in namespaces:
        above = above.rpartition("/")[0]
    if above not in namespaces and len(namespaces) > 1:
        raise ValueError(f"several robots' tf ({', '.join(topics)}), none above {scan_topic}")
    return [topic for topic in topics if len(namespaces) == 1 or topic.rpartition("/")[0] == above]


def _content(bag: BagFile, topics: set[str]) -> _Content:
    content = _Content()
    for message in bag.messages(topics):
        match bag.topics[message.topic]:
            case kind if kind == LASER_SCAN and (beams := len(message.content.ranges)) > MAX_BEAMS:
                problem = f"a scan of {beams} beams; at most {MAX_BEAMS} are read"
                content.skipped.append(SkippedLine(message.number, problem))
            case kind if kind == LASER_SCAN:
                content.scans.append(message)
            case kind if kind == ODOMETRY:
                content.poses.append(message)
            case _:
                fixed = message.topic.endswith("tf_static")
                for one in message.content.transforms:
                    try:
                        content.transforms.append(_transform(one, message, fixed=fixed))
                    except ValueError as problem:
                        content.skipped.append(SkippedLine(message.number, str(problem)))
    content.skipped += bag.left_out
    return content


def _entries(
    content: _Content, odom_topics: Sequence[str], settings: BridgeSettings
) -> list[Entry]:
    if not content.scans:
        why = f": {content.skipped[0].problem}" if content.skipped else ""
        raise ValueError(f"no scan in it can be read{why}")
    tree = _tree_of(content)
    base, odometry = _odometry_of(content, tree, odom_topics, settings)
    entries = odometry + _laser_entries(content, tree, base, settings)
    return [entry for _, _, entry in sorted(entries, key=lambda one: one[:2])]


def _tree_of(content: _Content) -> TransformTree:
    """Return the tree of all links; a link that never moves counts as fixed."""
    by_link: dict[tuple[str, str], list[_Transform]] = {}
    for one in content.transforms:
        by_link.setdefault((one.parent, one.child), []).append(one)
    tree = TransformTree(cache_ns=None, slack_ns=MAX_EXTRAPOLATION_NS)
    for sent in by_link.values():
        fixed = sent[-1].fixed or all(one.is_same(sent[0]) for one in sent)
        for one in sent[-1:] if fixed else sent:
            tree.add(one.stamp_ns, one.parent, one.child, one.parent_from_child, fixed=fixed)
    return tree


def _refuse_two_parents(content: _Content, way: Sequence[str]) -> None:
    for frame in way[:-1]:
        parents = sorted({one.parent for one in content.transforms if one.child == frame})
        if len(parents) > 1:
            named = " and ".join(parents)
            raise ValueError(f"tf gives the frame {frame!r} {len(parents)} parents: {named}")


_Sorted = tuple[int, int, Entry]
"""Time of recording [ns], rank of the sensor at equal times, entry."""


def _odometry_of(
    content: _Content, tree: TransformTree, odom_topics: Sequence[str], settings: BridgeSettings
) -> tuple[str, list[_Sorted]]:
    """Return the robot's frame, and the odometry entries."""
    frames = content.frames()
    if settings.odom_topic:
        return _topic_odometry(content, settings)
    way = next((way for way in map(tree.way_up, frames) if len(way) > 1), frames[:1])
    _refuse_two_parents(content, way)
    odom_frame = settings.odom_frame or ODOM_FRAME
    if odom_frame in way[1:]:
        base = settings.base_frame or way[way.index(odom_frame) - 1]
        return base, _tf_odometry(content, tree, odom_frame, base)
    if len(odom_topics) == 1:
        return _topic_odometry(content, settings)
    if odom_topics:
        held = ", ".join(odom_topics)
        raise ValueError(
            f"tf has no frame {odom_frame!r} above the laser's and there are "
            f"{len(odom_topics)} topics of odometry: {held}; {_by_name('odom_topic')}"
        )
    if len(way) == 1 and any(one.parent == odom_frame for one in content.transforms):
        raise ValueError(
            f"no transform of the laser's frame {way[0]!r}; tf has {tree}: record /tf_static, too"
        )
    raise ValueError(
        f"no odometry: above the laser's frame tf has {' <- '.join(reversed(way))}, "
        f"without {odom_frame!r}; {_by_name('odom_frame')}; tf holds {tree}"
    )


def _topic_odometry(content: _Content, settings: BridgeSettings) -> tuple[str, list[_Sorted]]:
    bases = sorted({frame_name(one.content.child_frame_id) for one in content.poses})
    base = settings.base_frame or (bases[0] if len(bases) == 1 else "")
    if not base:
        raise ValueError(f"odometry is of the frames {bases}; {_by_name('base_frame')}")
    return base, [(one.time_ns, 0, _topic_entry(one)) for one in content.poses]


def _tf_odometry(
    content: _Content, tree: TransformTree, odom_frame: str, base: str
) -> list[_Sorted]:
    """Return the robot's pose at each transform of the uppermost moving link."""
    way = tree.way_up(base, to=odom_frame)
    if way[-1] != odom_frame or len(way) == 1:
        raise ValueError(f"no transform from {odom_frame!r} to {base!r}; tf has {tree}")
    _refuse_two_parents(content, way)
    child = next((frame for frame in reversed(way[:-1]) if tree.moves(frame)), way[-2])
    found: list[_Sorted] = []
    for at in content.transforms:
        if at.child == child:
            with suppress(TransformMissingError):  # another link begins later or ends earlier
                pose = tree.lookup(odom_frame, base, at.stamp_ns).planar()
                found.append((at.time_ns, 0, _odometry_entry(at.number, at.stamp_ns, pose)))
    return found


def _laser_entries(
    content: _Content, tree: TransformTree, base: str, settings: BridgeSettings
) -> list[_Sorted]:
    entries: list[_Sorted] = []
    problems: list[str] = []
    given = (settings.laser_x_m, settings.laser_y_m, settings.laser_heading_rad)
    for frame in content.frames():
        try:
            is_known, problem = _is_mount_known(content, tree, base, frame, given), ""
        except ValueError as error:
            is_known, problem = False, str(error)
        for scan in content.scans:
            if _frame_of(scan) != frame:
                continue
            try:
                if problem:
                    raise ValueError(problem)
                stamp_ns = nanoseconds(scan.content.header.stamp)
                mount, upside_down = given, False
                if is_known:
                    base_from_laser = tree.lookup(base, frame, stamp_ns)
                    mount = base_from_laser.planar()
                    upside_down = is_upside_down(frame, base_from_laser)
                entry = _laser_entry(scan, frame, mount, upside_down=upside_down)
                entries.append((scan.time_ns, 1, entry))
            except ValueError as error:
                problems.append(str(error))
                content.skipped.append(SkippedLine(scan.number, str(error)))
    if not entries:
        raise ValueError(problems[0])
    return entries


def _is_mount_known(
    content: _Content, tree: TransformTree, base: str, frame: str, given: PoseTuple
) -> bool:
    """Return whether the mount of a laser is in tf; False: it is in the settings."""
    if frame == base or tree.knows(frame):
        _refuse_two_parents(content, tree.way_up(frame, to=base))
        return True
    if any(given):
        return False
    raise ValueError(
        f"no transform from {base!r} to the laser's frame {frame!r}; tf has {tree}; say "
        "where the laser is by bridge.laser_x_m, laser_y_m and laser_heading_rad"
    )


def _laser_entry(message: BagMessage, frame: str, mount: PoseTuple, *, upside_down: bool) -> Entry:
    scan = message.content
    limit = float(scan.range_max)
    ranges = np.array(scan.ranges, np.float32)
    with np.errstate(invalid="ignore"):
        ranges[ranges < scan.range_min] = 0.0
    reading = LaserReading(
        sender=SENDER,
        stamp_ns=nanoseconds(scan.header.stamp),
        ranges=ArrayBlob.of(ranges, "float32"),
        angle_min_rad=float(scan.angle_min),
        angle_step_rad=float(scan.angle_increment),
        range_max_m=limit if limit > 0.0 else math.inf,
        robot_from_laser=mount,
        laser=frame,
        upside_down=upside_down,
    )
    return Entry(message.number, reading)


def _topic_entry(message: BagMessage) -> Entry:
    pose = message.content.pose.pose
    x, y, z, w = (getattr(pose.orientation, axis) for axis in "xyzw")
    heading = math.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)
    odom_from_robot = (pose.position.x, pose.position.y, heading)
    stamp_ns = nanoseconds(message.content.header.stamp)
    return _odometry_entry(message.number, stamp_ns, odom_from_robot)


def _odometry_entry(number: int, stamp_ns: int, pose: PoseTuple) -> Entry:
    reading = OdometryReading(sender=SENDER, stamp_ns=stamp_ns, odom_from_robot=pose)
    return Entry(number, reading)


def _transform(link: Any, message: BagMessage, *, fixed: bool) -> _Transform:
    parent, child = frame_name(link.header.frame_id), frame_name(link.child_frame_id)
    try:
        there = rigid_of(link.transform.translation, link.transform.rotation)
    except ValueError as problem:
        raise ValueError(f"from {parent!r} to {child!r} tf has {problem}") from None
    at = (message.number, message.time_ns, nanoseconds(link.header.stamp))
    return _Transform(*at, parent, child, there, fixed)


def _frame_of(scan: BagMessage) -> str:
    return frame_name(scan.content.header.frame_id)
