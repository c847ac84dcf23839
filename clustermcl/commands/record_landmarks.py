"""`clustermcl record-landmarks`: add unknown landmarks that a localized robot sees to a file."""

import gzip
import logging
from collections import Counter
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
import yaml

from clustermcl.commands.options import argument, client_command
from clustermcl.commands.record import handle_until_stopped, listen
from clustermcl.filter.arrays import Pose
from clustermcl.filter.motion.trajectory import Trajectory
from clustermcl.filter.observations.sighting import Sighting
from clustermcl.filter.poses import between, compose
from clustermcl.jobs.wire_observations import from_wire
from clustermcl.link.node import Node
from clustermcl.protocol import keys
from clustermcl.protocol.answers import Belief
from clustermcl.protocol.pose_arrays import covariance_matrix
from clustermcl.protocol.reading_checks import observation_problem
from clustermcl.protocol.steps import MAX_LANDMARKS, Observation, OdometryReading
from clustermcl.recordings.maps.landmarks import landmarks_and_entries
from clustermcl.runtime.output_files import check_output_file, write_output_file
from clustermcl.runtime.settings import Settings
from clustermcl.runtime.stop import StopFlag, stop_on_signals

MIN_OBSERVATIONS = 5
"""A landmark that was observed at fewer steps is not written."""
MAX_OBSERVATIONS = 200
MOST_SCATTER_M = 1.0
"""Observations farther from the median of their name are false [m]."""
LEAST_RIGHT = 0.7
"""A name with a smaller share of right observations stands for several landmarks, or a moving one.
"""
LEAST_SIGMA_M = 0.02
"""Least standard deviation: errors of map and mount do not average out [m]."""
NOTHING_OBSERVED = (
    f"no observation has arrived on ROBOT/{keys.OBSERVATION_READING}: does a sensor publish there, "
    "with this robot's name for ROBOT?"
)
_MOST_WAITING = 64

_log = logging.getLogger(__name__)


@client_command
def record_landmarks(
    settings: Settings,
    file: Annotated[Path, argument("FILE.yaml", "Landmarks are added to an existing file.")],
) -> None:
    """Measure landmarks in sight, until Ctrl-C."""
    typer.echo("\n".join(run_record_landmarks(settings, file, stop_on_signals())))


def run_record_landmarks(settings: Settings, path: Path, stop: StopFlag) -> list[str]:
    """Measure unknown landmarks until the stop flag is set, then add them to the file.

    Return a line for each name that was observed, and one for the file.
    """
    check_output_file(path)
    known, entries = landmarks_and_entries(path) if path.exists() else ((), [])
    survey = LandmarkSurvey({each.name for each in known})
    with closing(Node("record-landmarks", "recorder", settings, stop, peers=None)) as node:
        listen(node, keys.ODOMETRY, OdometryReading, survey.on_odometry, 4096)
        listen(node, keys.BELIEF, Belief, survey.on_belief, 64)
        listen(node, keys.OBSERVATION_READING, Observation, survey.on_observation, 256)
        node.open(settings.zenoh.connect_timeout_s)
        handle_until_stopped(node)
    if added := list(survey.entries()):
        file = {"landmarks": [*entries, *added]}
        text = yaml.safe_dump(file, sort_keys=False, allow_unicode=True).encode()
        write_output_file(path, gzip.compress(text) if path.suffix == ".gz" else text)
    return [*survey.lines(), f"{path}: {len(added)} landmarks added"]


class LandmarkSurvey:
    """Averages the positions of unknown landmarks, with one observation of each in a step."""

    def __init__(self, known: set[str]) -> None:
        self._known = known
        self.observed: Counter[str] = Counter()
        """Number of observations that arrived, by name."""
        self._trajectory = Trajectory(most=400)
        self._waiting: list[tuple[int, Sighting]] = []
        self._belief: Belief | None = None
        self._steps: dict[str, int] = {}
        """Step of the last observation of each name."""
        self._seen: dict[str, list[tuple[Pose, Pose]]] = {}
        """Positions (2,) in the map and their covariances (2, 2)."""
        self._floors: dict[str, str] = {}
        """Floor of the first position of each name, in a building; others are not used."""

    def on_belief(self, belief: Belief) -> None:
        self._belief = belief

    def on_observation(self, message: Observation) -> None:
        """Queue an observation until odometry of its time has arrived."""
        seen = None if observation_problem(message) else from_wire(message)
        if not isinstance(seen, Sighting):
            return
        if seen.landmark in self.observed or len(self.observed) < MAX_LANDMARKS:
            self.observed[seen.landmark] += 1
        if seen.landmark in self._known:
            return
        self._waiting = [*self._waiting, (message.stamp_ns, seen)][-_MOST_WAITING:]

    def on_odometry(self, reading: OdometryReading) -> None:
        self._trajectory.add(reading.stamp_ns, reading.odom_from_robot)
        ready = [each for each in self._waiting if each[0] <= reading.stamp_ns]
        self._waiting = [each for each in self._waiting if each[0] > reading.stamp_ns]
        for stamp_ns, seen in ready:
            self._place(stamp_ns, seen)

    def _place(self, stamp_ns: int, seen: Sighting) -> None:
        belief, pose = self._belief, self._trajectory.pose_at(stamp_ns)
        if belief is None or belief.state != "localized" or pose is None:
            return
        name, best = seen.landmark, belief.hypotheses[0]
        if self._steps.get(name) == belief.step or (
            name not in self._seen and len(self._known) + len(self._seen) >= MAX_LANDMARKS
        ):
            return
        self._steps[name] = belief.step
        since = between(np.array(belief.odom_from_robot), np.array(pose))
        x, y, heading = compose(np.array(best.pose), since)
        cos, sin = np.cos(heading), np.sin(heading)
        map_from_robot = np.array([[cos, -sin], [sin, cos]])
        off = map_from_robot @ seen.mean
        by_pose = np.array([[1.0, 0.0, -off[1]], [0.0, 1.0, off[0]]])
        covariance = by_pose @ covariance_matrix(best.covariance) @ by_pose.T
        covariance += map_from_robot @ seen.covariance @ map_from_robot.T
        if self._floors.setdefault(name, best.floor) != best.floor:
            return
        positions = self._seen.setdefault(name, [])
        positions.append((np.array([x, y]) + off, covariance))
        del positions[:-MAX_OBSERVATIONS]
        if len(positions) == MIN_OBSERVATIONS:
            _log.info("landmark %s was seen at %d steps, which is enough", name, MIN_OBSERVATIONS)

    def lines(self) -> Iterator[str]:
        """Yield how often each name was observed, as text."""
        if not self.observed:
            yield NOTHING_OBSERVED
        for name, count in sorted(self.observed.items()):
            steps = len(self._seen.get(name, ()))
            used = f"at {steps} localized steps" if steps else "never while localized"
            if 0 < steps < MIN_OBSERVATIONS:
                used += f", left out: fewer than {MIN_OBSERVATIONS}"
            yield f"{name}: {count} observations, " + (
                "already in the file" if name in self._known else used
            )

    def entries(self) -> Iterator[dict[str, Any]]:
        """Yield the found landmarks as entries of a landmarks file."""
        for name, seen in sorted(self._seen.items()):
            positions, covariances = map(np.array, zip(*seen, strict=True))
            off_m = np.hypot(*(positions - np.median(positions, axis=0)).T)
            right = off_m <= MOST_SCATTER_M
            count, of = int(np.count_nonzero(right)), len(seen)
            if count < max(MIN_OBSERVATIONS, LEAST_RIGHT * of):
                what = f"{count} of {of} observations are within {MOST_SCATTER_M} m of the median"
                _log.warning("landmark %s is left out: %s", name, what)
                continue
            positions, covariances = positions[right], covariances[right]
            weights = np.linalg.inv(covariances)
            stated = np.linalg.inv(weights.sum(axis=0))
            x, y = stated @ (weights @ positions[:, :, None]).sum(axis=0)[:, 0]
            scattered = np.cov(positions.T) / count
            covariance = max(stated, scattered, key=np.trace) + LEAST_SIGMA_M**2 * np.eye(2)
            yield {
                "id": name,
                **({"floor": floor} if (floor := self._floors[name]) else {}),
                "x": round(float(x), 3),
                "y": round(float(y), 3),
                "covariance": [round(value, 6) for value in covariance.ravel().tolist()],
                "count": count,
            }
