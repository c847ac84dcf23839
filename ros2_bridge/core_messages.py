"""Messages to the system in their newest form: who knows less leaves the rest unread."""

from protocol.answers import SetPose
from protocol.arrays import ArrayBlob
from protocol.message import Covariance, Message, PoseTuple
from protocol.steps import LaserReading


class NamedLaserReading(LaserReading, frozen=True, kw_only=True, tag="laser_reading/1"):
    """A scan of one of several lasers."""

    laser: str
    """Which of them."""


class MapReading(Message, frozen=True, kw_only=True, tag="map_reading/1"):
    """The map that the robot has, or has now instead of another."""

    cell_m: float
    """Side of a cell."""
    map_from_grid: PoseTuple
    """Pose of the low corner of cell [0, 0] in the map frame."""
    occupancy: ArrayBlob
    """(height, width) int8, row 0 has the lowest y: 0 free, 100 occupied, all else unknown."""


class GivenPose(SetPose, frozen=True, kw_only=True, tag="set_pose/1"):
    """Where the robot was at a time."""

    covariance: Covariance
    """Of the pose; it stands in for both sigmas."""
    stamp_ns: int | None
    """When the robot was there, by its own clock: the odometry since is added. None: now."""


class Update(Message, frozen=True, kw_only=True, tag="update/1"):
    """Make a step of the next scan, also of a robot that stands."""

    command_id: str
    """The same id again does nothing."""
