"""Readings from a robot to the bridge, and what the bridge makes of them: steps and the map."""

from typing import TypeAlias

import msgspec

from protocol.arrays import ArrayBlob
from protocol.live_settings import AS_STARTED, LiveSettings
from protocol.message import Message, PoseTuple


class OdometryReading(Message, frozen=True, kw_only=True, tag="odometry_reading/1"):
    """One odometry pose. From a robot on ``readings/odometry``; the next one repairs a loss."""

    stamp_ns: int
    odom_from_robot: PoseTuple


class LaserReading(Message, frozen=True, kw_only=True, tag="laser_reading/1"):
    """One raw scan. From a robot on ``readings/laser``; losing one costs nothing but a step."""

    stamp_ns: int
    ranges: ArrayBlob
    """(B,) float32 [m], counter-clockwise; not finite, <= 0 or >= range_max_m: no return."""
    angle_min_rad: float
    """Direction of the first beam in the laser's frame."""
    angle_step_rad: float
    range_max_m: float
    robot_from_laser: PoseTuple
    odom_from_robot: PoseTuple | None = None
    """Odometry at the scan's time, where the source knows it; else it is interpolated."""
    laser: str = ""
    """Which of the robot's lasers, where it has several: each has a name of its own."""
    range_min_m: float = 0.0
    """A reading below it is no return."""
    upside_down: bool = False
    """The laser is mounted on its head: its beams go clockwise as seen from above."""


Reading: TypeAlias = OdometryReading | LaserReading


class MapReading(Message, frozen=True, kw_only=True, tag="map_reading/1"):
    """The map that the robot has, or has now instead of another.

    From a robot on ``readings/map``, when it has one and whenever that changes; it answers queries
    there too, for the bridge may come later. As ROS has it in `nav_msgs/OccupancyGrid`.
    """

    cell_m: float
    """Side of a cell (`resolution`)."""
    map_from_grid: PoseTuple
    """Pose of the low corner of cell [0, 0] in the map frame (`origin`)."""
    occupancy: ArrayBlob
    """(height, width) int8, row 0 has the lowest y: 0 free, 100 occupied, all else unknown."""


class LaserBeams(msgspec.Struct, frozen=True, kw_only=True):
    """What one laser measured, as from where the robot was at a step."""

    robot_from_laser: PoseTuple
    angle_min_rad: float
    angle_step_rad: float
    range_max_m: float
    ranges: ArrayBlob
    """As in `Scan`."""


class Scan(Message, frozen=True, kw_only=True, tag="scan/1"):
    """One step: a gated scan with the odometry pose at its time.

    Sent by the bridge on ``scan``, in the order of the steps; read by workers and coordinator.
    A worker that loses one moves by the difference of odometry and loses that step's evidence.
    """

    step: int
    stamp_ns: int
    odom_from_robot: PoseTuple
    robot_from_laser: PoseTuple
    angle_min_rad: float
    angle_step_rad: float
    range_max_m: float
    ranges: ArrayBlob
    """(B,) float32 [m], counter-clockwise; not finite, <= 0 or >= range_max_m: no return."""
    map_digest: str
    paced: bool = False
    """The bridge sends the next step only when this one's belief is out."""
    last: bool = False
    """The recording ends here."""
    live: bool = False
    """Stamps are of a robot's own clock, which runs like any other: they tell how late a message
    is, and the robot's place outlives our processes. Not so of a recording or a simulation."""
    standing: bool = False
    """Since the step before, the robot has moved less than makes a step: somebody asked for this
    one. It shows what that one showed."""
    others: tuple[LaserBeams, ...] = ()
    """What the robot's other lasers saw a moment before. Where it has driven in between, their
    places on it are changed by that, so that all beams are as from this step's pose."""
    settings: LiveSettings = AS_STARTED
    """What holds from this step on in place of the settings of the start."""


class ScanHistory(Message, frozen=True, kw_only=True, tag="scan_history/1"):
    """Steps of the past. The bridge's answer to a query on ``scans``; ask again after a loss."""

    scans: tuple[Scan, ...]
    """In the order of the steps; older ones than the bridge keeps are missing."""


class MapMessage(Message, frozen=True, kw_only=True, tag="map/1"):
    """The map. The bridge's answer to a query on ``map``; ask again after a loss."""

    digest: str
    cell_m: float
    map_from_grid: PoseTuple
    """Pose of the low corner of cell [0, 0] in the map frame."""
    rows: int
    cols: int
    zlib_cells: bytes
    """zlib of rows x cols int8, row 0 has the lowest y: 0 free, 1 occupied, -1 unknown."""


class TruePose(Message, frozen=True, kw_only=True, tag="true_pose/1"):
    """Where the robot really is. On ``truth``, once a step.

    From the simulator, or from a demo that plays a recording with its reference.
    """

    step: int
    map_from_robot: PoseTuple
