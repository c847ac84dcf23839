"""A run that was recorded as a bag (`clustermcl record`), told to the page without computing it."""

import logging
import math
from collections.abc import Iterator
from itertools import groupby
from operator import attrgetter
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from live_view.picture import Picture
from live_view.recorded_run import Telling, best_pose
from protocol.answers import Belief
from protocol.arrays import ArrayBlob
from protocol.errors import RecordingError
from protocol.message import PoseTuple
from protocol.steps import LaserBeams, Scan
from protocol.work import Particles
from recordings.bag_file import BagFile, BagMessage
from recordings.ros_messages import BASE, BELIEF_TOPIC

_SCAN, _CLOUD, _LINKS = "/scan", "/particle_cloud", ("/tf", "/tf_static")
_CLOUD_EVERY_STEPS = 10
"""As workers report their particles; odometry carries them on."""
_M_PER_RAD = 1.0
"""What a turn counts when poses are given to the nearest place."""

_log = logging.getLogger(__name__)


def bag_run(bag: BagFile, path: Path) -> Telling:
    """What a recorded bag tells the page.

    Args:
        bag: is read while it is told.
        path: of the bag, for what errors say.

    Raises:
        RecordingError: it holds no beliefs.
    """
    if BELIEF_TOPIC not in bag.topics:
        problem = f"no beliefs in it (topic {BELIEF_TOPIC}): it was not made by clustermcl record"
        remedy = f"localize in it by: clustermcl demo --view --recording {path}"
        raise RecordingError(path, f"{problem}; {remedy}")

    def tell(picture: Picture) -> Iterator[None]:
        teller = _BagTeller(picture)
        messages = bag.messages([BELIEF_TOPIC, _SCAN, _CLOUD, *_LINKS])
        for _, at_once in groupby(messages, attrgetter("time_ns")):
            teller.on_messages(list(at_once))
            yield
        for one in bag.left_out[:1]:
            _log.warning("%s: left out, message %d: %s", path, one.number, one.problem)

    return tell


class _BagTeller:
    """Puts together what belongs to a step: all of it has the time of its scan."""

    def __init__(self, picture: Picture) -> None:
        self._picture = picture
        self._mounts: dict[str, PoseTuple] = {}

    def on_messages(self, messages: list[BagMessage]) -> None:
        """All that was recorded at one time."""
        by_topic: dict[str, list[Any]] = {}
        for message in messages:
            by_topic.setdefault(message.topic, []).append(message.content)
        for topic in _LINKS:
            for content in by_topic.get(topic, ()):
                self._on_links(content)
        for content in by_topic.get(BELIEF_TOPIC, ()):
            belief = _belief_in(content)
            if belief is not None:
                self._on_belief(belief, by_topic)

    def _on_links(self, content: Any) -> None:
        for link in content.transforms:
            if link.header.frame_id == BASE:
                shift, turn = link.transform.translation, link.transform.rotation
                self._mounts[link.child_frame_id] = (shift.x, shift.y, _heading(turn))

    def _on_belief(self, belief: Belief, with_it: dict[str, list[Any]]) -> None:
        beams = [self._beams(one) for one in with_it.get(_SCAN, ())]
        if beams:
            self._picture.on_scan(_scan(belief, beams))
        self._picture.on_belief(belief)
        self._picture.on_pose(best_pose(belief))
        if belief.step % _CLOUD_EVERY_STEPS == 0:
            for content in with_it.get(_CLOUD, ()):
                for cluster, particles in _clouds(belief, content):
                    self._picture.on_particles(cluster, particles)

    def _beams(self, message: Any) -> LaserBeams:
        return LaserBeams(
            robot_from_laser=self._mounts.get(message.header.frame_id, (0.0, 0.0, 0.0)),
            angle_min_rad=float(message.angle_min),
            angle_step_rad=float(message.angle_increment),
            range_max_m=float(message.range_max),
            ranges=ArrayBlob.of(message.ranges, "float32"),
        )


def _belief_in(content: Any) -> Belief | None:
    try:
        return msgspec.json.decode(content.data, type=Belief)
    except msgspec.DecodeError as error:
        _log.warning("left out, a belief: %s", error)
        return None


def _scan(belief: Belief, beams: list[LaserBeams]) -> Scan:
    first, *others = beams
    return Scan(
        sender=belief.sender,
        step=belief.step,
        stamp_ns=belief.stamp_ns,
        odom_from_robot=belief.odom_from_robot,
        robot_from_laser=first.robot_from_laser,
        angle_min_rad=first.angle_min_rad,
        angle_step_rad=first.angle_step_rad,
        range_max_m=first.range_max_m,
        ranges=first.ranges,
        map_digest="",
        others=tuple(others),
    )


def _clouds(belief: Belief, content: Any) -> Iterator[tuple[int, Particles]]:
    """The drawn poses by the place that is nearest to each."""
    if not belief.hypotheses or not content.poses:
        return
    drawn = [(one.position.x, one.position.y, _heading(one.orientation)) for one in content.poses]
    poses = np.array(drawn)
    nearest = _nearest(poses, np.array([place.mean for place in belief.hypotheses]))
    for index in np.unique(nearest):
        its = poses[nearest == index]
        yield (
            belief.hypotheses[index].cluster,
            Particles(
                step=belief.step,
                odom_from_robot=belief.odom_from_robot,
                map_from_robot=ArrayBlob.of(its, "float64"),
                log_weights=ArrayBlob.of(np.zeros(len(its)), "float64"),
            ),
        )


def _nearest(poses: NDArray[np.float64], places: NDArray[np.float64]) -> NDArray[np.int64]:
    """Of each of (N, 3) poses, the row of the nearest of (K, 3) places."""
    apart = poses[:, None] - places[None]
    turned = np.abs((apart[..., 2] + np.pi) % (2.0 * np.pi) - np.pi)
    distance = np.hypot(apart[..., 0], apart[..., 1]) + _M_PER_RAD * turned
    return np.asarray(np.argmin(distance, axis=1))


def _heading(turn: Any) -> float:
    return 2.0 * math.atan2(turn.z, turn.w)
