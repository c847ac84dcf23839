"""The library: Cluster-MCL in the caller's process, with the classes that the service uses."""

from __future__ import annotations  # `help` shows names of types, not their definitions

import io
import math
import warnings
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Any

import msgspec
import numpy as np
from numpy.typing import ArrayLike

from clustermcl.belief.commands import Commands
from clustermcl.belief.free_ground import FreeGround
from clustermcl.belief.outcome import Outcome, belief_after
from clustermcl.belief.pose_tracker import recent_odometry
from clustermcl.changes.collector import ChangeCollector
from clustermcl.jobs.in_process import InProcess
from clustermcl.jobs.map_model import sensor_model
from clustermcl.jobs.warm_up import compile_kernels
from clustermcl.protocol import answers
from clustermcl.protocol.advice import USUAL_RADIUS_M, Advice, advice_question
from clustermcl.protocol.answers import Relocalize, SetPose
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.causes import AnyCause, Cause, Named, key_of
from clustermcl.protocol.changes import Changes
from clustermcl.protocol.codec import refusal_of
from clustermcl.protocol.errors import CommandRefusedError
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.pose_arrays import checked_pose
from clustermcl.protocol.steps import Landmark, LaserReading, Observation, PositionField, Scan
from clustermcl.readings import Reading
from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.robot_commands import RobotCommands
from clustermcl.runtime.folders import kept_folder
from clustermcl.runtime.settings import Settings
from clustermcl.runtime.settings_file import with_setting
from clustermcl.sensor_bridge.step_maker import StepMaker

_SENDER = "library"
_BETWEEN_READINGS_NS = 1_000_000_000
_FULL_TURN = Named("heading beyond a full turn")
_A_MAP = "a GridMap, such as load_map('map.yaml')"
_FARTHEST_M = 100.0
"""Walls are nearer, or inside of the map."""


class Belief(answers.Belief, frozen=True, kw_only=True, tag="belief/1"):
    """The belief after one step, with the map and the scan for drawing it."""

    map: GridMap
    """The map in which all poses are given."""
    scan: Scan
    """The scan of the step."""

    __repr__ = answers.Belief.__repr__

    def plot(self, ax: Any = None) -> Any:
        """Draw the map, all places, and the scan at the most probable one; x and y in metres.

        Args:
            ax: axes of matplotlib to draw in; None: those of a new figure.

        Returns:
            The axes.

        Raises:
            ImportError: matplotlib, the extra ``plots``, is not installed.
        """
        from clustermcl.view import plots  # noqa: PLC0415 - only for drawing

        axes = ax or plots.new_figure().axes[0]
        plots.draw_map(axes, self.map)
        plots.draw_places(axes, self.map.floors.drawn(self).hypotheses, self.scan)
        axes.set_title(f"step {self.step}: {self.state}")
        return axes

    def _repr_png_(self) -> bytes | None:
        """Return `plot` as PNG, for notebooks; None without matplotlib."""
        file = io.BytesIO()
        with suppress(ImportError):
            self.plot().figure.savefig(file, format="png")
        return file.getvalue() or None


class ClusterMCL(RobotCommands):
    """A localizer of one robot in a known map.

        mcl = ClusterMCL(load_map("map.yaml"), robot_from_laser=(0.25, 0.0, 0.0))
        for reading in read_recording("robot.log"):
            if belief := mcl.update(reading):
                print(belief.state, belief.pose)

    With the same seed and readings, beliefs equal those of `clustermcl evaluate` and of a running
    system, bit for bit. Use an object in one thread only. If no compiled kernels are installed,
    the first object on a machine compiles them, for about ten seconds.

    Args:
        grid_map: the map, from `load_map`.
        robot_from_laser: mount of the laser, for readings that have none: x [m], y [m],
            heading [rad].
        landmarks: landmarks of the map, from `load_landmarks`; none: those that `grid_map` has.
        seed: seed of all random numbers; None: that of the settings.
        settings: `Settings`, or a dictionary of those that differ from their defaults, such as
            ``{"belief.max_clusters": 32}``; `clustermcl settings --all` lists all names.

    Attributes:
        map: the present map.
        belief: the belief after the last step or command; None before the first step, and after
            `change_map`.

    A reading that a robot may send, but that cannot be used, is counted in `dropped`; the first
    one of each cause gives a warning (`warnings`). A number that can never be right is a
    ValueError.

    Raises:
        ValueError: the map has no obstacle.
        SettingsError: a setting is unknown, of the wrong type or out of its range.
    """

    _SNAPSHOT_EVERY_STEPS = 0
    """Interval in which a subclass gets particles, in `self._filter.reports`; 0: never."""

    def __init__(
        self,
        grid_map: GridMap,
        *,
        robot_from_laser: PoseTuple = (0.0, 0.0, 0.0),
        landmarks: Sequence[Landmark] = (),
        seed: int | None = None,
        settings: Settings | Mapping[str, object] | None = None,
    ) -> None:
        _check(settings, Settings | Mapping | None, "settings", "{'belief.max_clusters': 32}")
        chosen = settings if isinstance(settings, Settings) else Settings()
        named = dict(settings) if isinstance(settings, Mapping) else {}
        named |= {} if seed is None else {"seed": seed}
        for name, value in named.items():
            chosen = with_setting(chosen, name, value, "ClusterMCL")
        self._settings = chosen
        self._robot_from_laser = checked_pose("robot_from_laser", robot_from_laser)
        self._stamp_ns, self._warned = 0, set[str]()
        _check(grid_map, GridMap, "the map", _A_MAP)
        compile_kernels(chosen.sensor)
        self._maker = StepMaker(chosen.bridge, grid_map.digest, _SENDER)
        self._commands, self._odometry = Commands(), recent_odometry()
        self.change_map(grid_map, landmarks)

    @property
    def dropped(self) -> Counter[str]:
        """Number of readings that could not be used, by cause."""
        return Counter({key_of(cause): n for cause, n in self._maker.dropped.items()})

    def __repr__(self) -> str:
        return f"<ClusterMCL in {self.map}: {self.belief or 'no step yet'}>"

    def update(self, reading: Reading, *, force: bool = False) -> Belief | None:
        """Process the next reading.

        Args:
            reading: a scan, odometry or both; readings must be in the order of time.
            force: use the next scan for a step, even if the robot stands still.

        Returns:
            The belief if this call made a step, perhaps of an earlier scan that waited for
            odometry. None if it made no step: the robot has not moved enough since the last one,
            there is no new scan, a scan waits for odometry, or the reading could not be used (see
            `dropped`).

        Raises:
            ValueError: every range is longer than the map.
        """
        if not isinstance(reading, Reading):
            raise TypeError(f"update takes a Reading, not {type(reading).__name__}: {reading!r}")
        if force:
            self._maker.gate.open_next()
        message = reading.as_message(self._stamp_ns, self._robot_from_laser)
        if isinstance(message, LaserReading) and message.range_max_m > self._farthest_m:
            self._check_ranges(message)
        self._stamp_ns = message.stamp_ns + _BETWEEN_READINGS_NS
        scan = self._maker.on_reading(message)
        if message.odom_from_robot is not None and abs(message.odom_from_robot[2]) > math.tau:
            self._warn(_FULL_TURN, f"right only if odometry counts turns in radians: {reading}")
        self._warn_of_dropped(reading)
        if self._maker.odometry is not None:
            self._odometry.add(*self._maker.odometry)
        return None if scan is None else self._advanced(scan)

    def observe(
        self,
        mean: ArrayLike,
        covariance: ArrayLike,
        *,
        landmark: str = "",
        field: ArrayLike | None = None,
        cell_m: float = 1.0,
        stamp_ns: int | None = None,
        source: str = "sensor",
        outlier_probability: float = 0.05,
        correlation_s: float = 30.0,
        floor: str = "",
        floors: Mapping[str, float] | None = None,
    ) -> None:
        """Add an observation of another sensor; the next step uses it.

        The first observation of a landmark makes the next scan a step, even if the robot stands.

        Args:
            mean: position of the landmark in the robot's frame, (2,) [m]. Without a landmark:
                the robot's (3,) pose in the map, or its (2,) position if the heading is unknown.
                Of a field: its (2,) low corner in the map.
            covariance: (2, 2) or (3, 3) covariance of `mean`, positive definite [m^2, rad^2]; it
                blurs a field.
            landmark: id or class of a landmark; empty: the robot's pose is observed.
            field: (rows, cols) log-likelihoods of the robot's position in cells along the axes of
                the map, at most 64 x 64; row 0 has the lowest y. None: `mean` is observed.
            cell_m: side of a field's cell [m].
            stamp_ns: time by the robot's clock [ns]; None: that of the newest odometry.
            source: name of the sensor; errors of one sensor are correlated.
            outlier_probability: probability that the observation is false.
            correlation_s: time after which 63 % of the sensor's error is new [s].
            floor: the floor of `mean`, in a building of several, except for a landmark.
            floors: how likely the measurement is on each floor, as that of a barometer, in place of
                `mean` and `covariance`, which are not used.

        Raises:
            ValueError: a number is not finite or out of range, the heading is beyond a full turn,
                the covariance is not positive definite, or the field is too large.
        """
        if not landmark and np.size(mean) == 3:
            mean = checked_pose("mean", mean)
        cells = None
        if field is not None:
            values = ArrayBlob.of(np.asarray(field), "float32")
            cells = PositionField(cell_m=cell_m, log_likelihoods=values)
        newest = self._maker.odometry
        message = Observation(
            sender=source,
            stamp_ns=stamp_ns if stamp_ns is not None else newest[0] if newest else 0,
            landmark=landmark,
            mean=tuple(np.asarray(mean, np.float64).ravel().tolist()),
            covariance=tuple(np.asarray(covariance, np.float64).ravel().tolist()),
            outlier_probability=outlier_probability,
            correlation_s=correlation_s,
            field=cells,
            floor=floor,
            floors=dict(floors or {}),
        )
        if problem := refusal_of(message):
            raise ValueError(f"the observation is invalid: {problem}")
        self._maker.observe(message)
        self._warn_of_dropped(f"observation of {landmark or 'the pose'!r} by {source!r}")

    def _warn_of_dropped(self, of: object) -> None:
        for cause in self._maker.dropped.keys() - self._warned:
            means = cause.means if isinstance(cause, Cause) else ""
            told = means, self._maker.dropped.details.get(cause), str(of)
            self._warn(cause, ": ".join(filter(None, told)))

    def _warn(self, cause: AnyCause, text: str) -> None:
        if cause not in self._warned:
            self._warned.add(cause)
            warnings.warn(f"{key_of(cause).replace('_', ' ')}, shown once: {text}", stacklevel=4)

    def _check_ranges(self, scan: LaserReading) -> None:
        ranges = scan.ranges.array()
        returned = ranges[(ranges > scan.range_min_m) & (ranges < scan.range_max_m)]
        if returned.size and (nearest := float(returned.min())) > self._farthest_m:
            across = f"but the map measures {math.hypot(*self.map.size_m):.0f} m across"
            raise ValueError(f"the nearest range is {nearest:.0f} m, {across}: give metres")

    def finish(self) -> Iterator[Belief]:
        """Make the steps of scans that still wait for odometry, and yield their beliefs.

        Call it after the last reading, and iterate over the result.
        """
        while (scan := self._maker.finish()) is not None:
            yield self._advanced(scan)

    def change_map(self, grid_map: GridMap, landmarks: Sequence[Landmark] = ()) -> None:
        """Use another map from the next scan on; drop all places, and search again.

        Raises:
            ValueError: the map has no obstacle.
        """
        _check(grid_map, GridMap, "the map", _A_MAP)
        for mark in landmarks:
            _check(mark, Landmark, "a landmark", "load_landmarks('landmarks.yaml')")
        self._farthest_m = max(_FARTHEST_M, math.hypot(*grid_map.size_m))
        self._model = sensor_model(grid_map, self._settings.sensor, kept_folder("maps"))
        self.map = grid_map.with_landmarks(landmarks or grid_map.landmarks)
        self._ground = FreeGround.of(self.map)
        self._maker.change_map(self.map.digest, self.map.landmarks, self.map.floors)
        self._filter = InProcess(self._model, self._settings, self._SNAPSHOT_EVERY_STEPS)
        self._collector = ChangeCollector(self.map)
        self.belief: Belief | None = None

    def advice(self, *, radius_m: float = USUAL_RADIUS_M) -> Advice:
        """Return ways for the robot to drive so that scans distinguish its possible places.

        Args:
            radius_m: radius of the robot [m].
        """
        from clustermcl.jobs.advising import advice  # noqa: PLC0415 - loads scipy

        belief = self.belief
        if belief is None:
            return Advice(sender=_SENDER, note="there is no belief yet")
        views, bridge = self._filter.ensemble.seen.views, self._settings.bridge
        question = advice_question(
            self.map.floors.drawn(belief).hypotheses,
            belief.elsewhere_probability,
            belief.scan,
            views,
            (bridge.gate_distance_m, bridge.gate_turn_rad),
            radius_m=radius_m,
            sender=_SENDER,
        )
        return advice(question, belief.scan, self._model, self._settings, _SENDER)

    def changes(self) -> Changes:
        """Return what has changed in the building since it was mapped, as far as it was seen."""
        return self._collector.changes(_SENDER)

    def _carry_out(self, command: SetPose | Relocalize) -> None:
        outcome = self._commands.carry_out(
            command, self._filter.ensemble, self._filter.applied, self._odometry, self._ground
        )
        if problem := self._commands.problems[command.command_id]:
            raise CommandRefusedError(command=type(command).__name__, problem=problem)
        if outcome is not None and self._filter.applied is not None:
            self._follow(outcome, self._filter.applied)

    def _advanced(self, scan: Scan) -> Belief:
        outcome = self._filter.advance(scan)
        self._collector.on_step(scan, outcome.state, outcome.hypotheses)
        belief = self._set_belief(outcome, scan)
        ensemble, ground = self._filter.ensemble, self._ground
        given = self._commands.carry_out_waiting(ensemble, scan, self._odometry, ground)
        return self._follow(given, scan) if isinstance(given, Outcome) else belief

    def _follow(self, outcome: Outcome, scan: Scan) -> Belief:
        self._filter.carry_out(outcome)
        return self._set_belief(outcome, scan)

    def _set_belief(self, outcome: Outcome, scan: Scan) -> Belief:
        plain = msgspec.structs.asdict(belief_after(scan, outcome, _SENDER))
        self.belief = Belief(**plain, map=self.map, scan=scan)
        self._maker.on_belief(self.belief)
        return self.belief


def _check(given: object, kind: Any, name: str, example: str) -> None:
    if not isinstance(given, kind):
        raise TypeError(f"{name} is {given!r}, a {type(given).__name__}: give {example}")
