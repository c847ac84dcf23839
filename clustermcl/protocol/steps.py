"""Readings from a robot to the bridge, and the steps and the map that the bridge sends on."""

from typing import Annotated, ClassVar, TypeAlias

import msgspec
from msgspec import Meta

from clustermcl.protocol.answers import MAX_FLOORS, FloorName
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.floors import ONE_MAP, Floors
from clustermcl.protocol.job_events import Remark
from clustermcl.protocol.live_settings import AS_STARTED, LiveSettings
from clustermcl.protocol.message import (
    LARGEST_BYTES,
    MAX_ID_CHARACTERS,
    MAX_POSE_M,
    SCAN_BYTES,
    Coordinate,
    Finite,
    Id,
    Message,
    Number,
    PoseTuple,
    Positive,
    Probability,
    ScanStep,
    Stamp,
)

MAX_BEAMS = 20_000
"""No current laser has more; a larger scan is an error."""


class OdometryReading(Message, frozen=True, kw_only=True, tag="odometry_reading/1", gc=False):
    """An odometry pose. From a robot on ``readings/odometry``; the next one repairs a loss."""

    stamp_ns: Stamp
    odom_from_robot: PoseTuple


class LaserReading(Message, frozen=True, kw_only=True, tag="laser_reading/1", gc=False):
    """A raw scan. From a robot on ``readings/laser``; losing one costs at most one step."""

    max_bytes: ClassVar[int] = SCAN_BYTES
    stamp_ns: int
    ranges: ArrayBlob
    """(B,) float32 [m], counter-clockwise; not finite, <= 0 or >= range_max_m: no return."""
    angle_min_rad: float
    """Direction of the first beam in the laser's frame."""
    angle_step_rad: float
    range_max_m: float
    robot_from_laser: PoseTuple
    odom_from_robot: PoseTuple | None = None
    """Odometry at the scan's time, if the source knows it; otherwise it is interpolated."""
    laser: str = ""
    """Name of the laser, where the robot has several."""
    range_min_m: float = 0.0
    """A range below it is no return."""
    upside_down: bool = False
    """The laser is mounted upside down: seen from above, its beams run clockwise."""


Reading: TypeAlias = OdometryReading | LaserReading


MAX_OBSERVATIONS = 32
"""Observations of one step."""
MAX_REMARKS = 16
"""Remarks of one step."""
MAX_LANDMARKS = 500
"""Landmarks of one map."""
Numbers: TypeAlias = Annotated[tuple[Finite, ...], Meta(min_length=2, max_length=9)]
LandmarkName: TypeAlias = Annotated[str, Meta(max_length=MAX_ID_CHARACTERS)]
OutlierProbability: TypeAlias = Annotated[float, Meta(ge=1e-6, le=0.999)]


Sigma: TypeAlias = Annotated[float, Meta(gt=0.0, le=MAX_POSE_M)]
MAX_FIELDS = 4
"""Fields of one step."""
MAX_FIELD_SIDE = 64
"""Cells along each side of a field."""


class PositionField(msgspec.Struct, frozen=True, kw_only=True):
    """Log-likelihoods of the robot's position in cells along the axes of the map."""

    cell_m: Annotated[float, Meta(ge=0.01, le=MAX_POSE_M)]
    """Side of a cell [m]."""
    log_likelihoods: ArrayBlob
    """(rows, cols) float32, row 0 has the lowest y; a constant added to all has no effect."""
    map_digest: str = ""
    """The map that it was made for; empty: any."""


FloorLikelihoods: TypeAlias = Annotated[dict[FloorName, Probability], Meta(max_length=MAX_FLOORS)]


class Observation(Message, frozen=True, kw_only=True, tag="observation/1"):
    """What another sensor says about the robot's pose. From a robot on ``readings/observation``.

    The next one repairs a loss. One `sender` is one source, whose errors are correlated.
    """

    stamp_ns: Stamp
    landmark: LandmarkName = ""
    """Id or class of a landmark in the map's landmarks file. Empty: `mean` is the robot's pose."""
    mean: Numbers
    """Of a landmark: x, y in the robot's frame [m]. Otherwise x, y [m], heading [rad] of the robot
    in the map; without the last number, the heading is unknown. Of a field: its low corner x, y in
    the map [m]."""
    covariance: Numbers
    """Of `mean`, row by row. An error of a field's position blurs it."""
    outlier_probability: OutlierProbability = 0.05
    """Probability that the observation is false."""
    correlation_s: Positive = 30.0
    """Time after which 63 % of the error of a source is new [s]."""
    field: PositionField | None = None
    """How likely the measurement is in each part of the map. The robot is in one of its cells with
    the probability that the observation is not false."""
    floor: FloorName = ""
    """The floor of `mean`; a building of several floors needs it, except for a landmark."""
    floors: FloorLikelihoods = msgspec.field(default_factory=dict)
    """How likely the measurement is on each floor, as that of a barometer; others are excluded.
    `mean` and `covariance` are not used."""


class Seen(msgspec.Struct, frozen=True, kw_only=True):
    """An observation, relative to the robot's pose at a step; fields as in `Observation`."""

    landmark: LandmarkName
    mean: Numbers
    covariance: Numbers
    outlier_probability: OutlierProbability
    share: Annotated[float, Meta(ge=0.0, le=1.0)]
    """Share of its log-likelihood that is new since earlier observations of the same thing."""
    field: PositionField | None = None


class Landmark(msgspec.Struct, frozen=True, kw_only=True):
    """A landmark of the map."""

    name: Id
    """Its id, or the name that it shares with others of its class."""
    x: Coordinate
    """Position in the map [m]."""
    y: Coordinate
    sigma: Sigma
    """Standard deviation of the position along each axis [m]."""


class MapReading(Message, frozen=True, kw_only=True, tag="map_reading/1"):
    """The robot's map, with the fields of `nav_msgs/OccupancyGrid`.

    A robot publishes it on ``readings/map`` whenever it changes, and answers queries there for a
    bridge that starts later.
    """

    max_bytes: ClassVar[int] = LARGEST_BYTES
    cell_m: float
    """Side of a cell (`resolution`)."""
    map_from_grid: PoseTuple
    """Pose of the low corner of cell [0, 0] in the map frame (`origin`)."""
    occupancy: ArrayBlob
    """(height, width) int8, row 0 has the lowest y [%]: 0 to 25 is free, 65 to 100 occupied,
    others unknown."""


class LaserBeams(msgspec.Struct, frozen=True, kw_only=True):
    """The measurement of one laser, relative to the robot's pose at a step."""

    robot_from_laser: PoseTuple
    angle_min_rad: Finite
    angle_step_rad: Finite
    range_max_m: float
    ranges: ArrayBlob
    """As in `Scan`."""


class Scan(Message, frozen=True, kw_only=True, tag="scan/1"):
    """One step: a gated scan with the odometry pose at its time.

    Sent by the bridge on ``scan``, in the order of the steps; read by workers and coordinator.
    A worker that loses one moves by the difference of odometry and loses that step's evidence.
    """

    max_bytes: ClassVar[int] = SCAN_BYTES
    step: ScanStep
    stamp_ns: Stamp
    odom_from_robot: PoseTuple
    motion_by_scans: PoseTuple | None = None
    """Motion since the step before as its scan and this one show it, if odometry contradicts it."""
    robot_from_laser: PoseTuple
    angle_min_rad: Finite
    angle_step_rad: Finite
    range_max_m: float
    ranges: ArrayBlob
    """(B,) float32 [m], counter-clockwise; not finite, <= 0 or >= range_max_m: no return."""
    map_digest: str
    lockstep: bool = False
    """Lockstep: the bridge sends the next step only after this one's belief."""
    last: bool = False
    """The recording ends here."""
    live: bool = False
    """The stamps are of a real robot's clock, so that they show a message's delay, and the last
    pose stays valid after a restart. False for a recording or a simulation."""
    others: tuple[LaserBeams, ...] = ()
    """The newest measurements of the robot's other lasers. Their `robot_from_laser` includes the
    motion since then, so that all beams are relative to this step's pose."""
    settings: LiveSettings = AS_STARTED
    """Live settings that apply from this step on."""
    own_robot_found: bool = False
    """Scans before this step showed parts of the robot, which are left out from now on. If no place
    is almost certain, the belief forgets them and searches again."""
    observations: Annotated[tuple[Seen, ...], Meta(max_length=MAX_OBSERVATIONS)] = ()
    """What other sensors have observed since the step before."""
    landmarks: Annotated[tuple[Landmark, ...], Meta(max_length=MAX_LANDMARKS)] = ()
    """All landmarks of the map, if one was observed."""
    remarks: Annotated[tuple[Remark, ...], Meta(max_length=MAX_REMARKS)] = ()
    """What the bridge refused, bridged or missed since the step before."""
    floors: Floors = ONE_MAP
    """Floors and links of the map, by which poses on floors and in the atlas are converted."""


def mirrored(scan: Scan) -> Scan:
    """Return the step mirrored at the robot's x axis, as a mirror-image building would show it.

    The mirrored robot has the same sensor noise, driver and building statistics, but is not
    on the map, unless the map is its own mirror image.
    """
    others = tuple(
        msgspec.structs.replace(other, **_mirrored_beams(other)) for other in scan.others
    )
    return msgspec.structs.replace(
        scan,
        odom_from_robot=_reflected(scan.odom_from_robot),
        motion_by_scans=scan.motion_by_scans and _reflected(scan.motion_by_scans),
        others=others,
        observations=(),
        **_mirrored_beams(scan),
    )


def _mirrored_beams(laser: Scan | LaserBeams) -> dict[str, object]:
    """Return the ranges in reverse order, and the angle of the first."""
    last_rad = laser.angle_min_rad + laser.angle_step_rad * (laser.ranges.shape[0] - 1)
    return {
        "ranges": ArrayBlob.of(laser.ranges.array()[::-1], "float32"),
        "angle_min_rad": -last_rad,
        "robot_from_laser": _reflected(laser.robot_from_laser),
    }


def _reflected(pose: PoseTuple) -> PoseTuple:
    x, y, heading = pose
    return x, -y, -heading


KEPT_STEPS = 300
"""Steps that the bridge keeps for workers that join late; older ones cannot be applied."""


class ScanHistory(Message, frozen=True, kw_only=True, tag="scan_history/1"):
    """Past steps. The bridge's answer to a query on ``scans``; query again after a loss."""

    max_bytes: ClassVar[int] = LARGEST_BYTES
    scans: tuple[Scan, ...]
    """In the order of the steps, without those that the bridge no longer keeps."""


class MapMessage(Message, frozen=True, kw_only=True, tag="map/1"):
    """The map. The bridge's answer to a query on ``map``; query again after a loss."""

    max_bytes: ClassVar[int] = LARGEST_BYTES
    digest: str
    cell_m: float
    map_from_grid: PoseTuple
    """Pose of the low corner of cell [0, 0] in the map frame."""
    rows: int
    cols: int
    zlib_cells: bytes
    """zlib of rows x cols int8, row 0 has the lowest y: 0 free, 1 occupied, -1 unknown."""
    landmarks: Annotated[tuple[Landmark, ...], Meta(max_length=MAX_LANDMARKS)] = ()
    """For display; steps carry those that the filter uses."""
    floors: Floors = ONE_MAP
    """Of the map, which is their atlas."""


class TruePose(Message, frozen=True, kw_only=True, tag="true_pose/1"):
    """Ground truth. Published on ``truth`` once a step, by the simulator or by a demo of a
    recording with a reference.
    """

    step: Number
    pose: PoseTuple
    floor: FloorName = ""
    """As in `Hypothesis`."""
