"""Why data is dropped or refused: the names of the counters in health, status, log and metrics."""

from enum import StrEnum
from typing import NewType, Self, TypeAlias

Named = NewType("Named", str)
"""The name of a counter that contains another name, or a line of the log that is not counted."""


class Cause(StrEnum):
    """A cause by the name of its counter. docs/operations.md says what to do."""

    means: str
    """What has happened, for a user."""

    def __new__(cls, counter: str, means: str) -> Self:
        cause = str.__new__(cls, counter)
        cause._value_, cause.means = counter, means
        return cause

    MALFORMED = "reading refused: malformed", "an array has a wrong shape, or a name is too long"
    NOT_FINITE = "reading refused: not finite", "a number is NaN, infinite or out of range"
    BAD_GEOMETRY = "reading refused: bad geometry", "the beams span no angle, or over a full turn"
    NO_BEAMS = "reading refused: no beams", "the scan is empty"
    TOO_MANY_BEAMS = "reading refused: too many beams", "the scan has more than 20,000 beams"
    NO_RETURNS = "reading refused: no returns", "no range is from range_min to range_max, in metres"
    STEPS_BACK = "reading refused: stamp steps back", "it is over 1 s older than an earlier one"
    NO_ODOMETRY = "reading refused: no odometry", "there is no odometry around its time"
    OUTLIER = "reading refused: outlier in time or place", "no later reading confirms its jump"
    TOO_MANY_LASERS = "reading refused: too many lasers", "the readings name more than 16 lasers"
    UNKNOWN_LANDMARK = "reading refused: unknown landmark", "its landmark is not on the map"
    UNKNOWN_FLOOR = "reading refused: unknown floor", "it names no floor of the building"
    AHEAD = "reading refused: observation from the future", "it is over 10 s newer than odometry"
    TOO_FAR_BACK = "reading refused: observation too far back", "motion since then has blurred it"
    OTHER_FIELD = "reading refused: field of another map", "its `map_digest` is not the map's"
    TOO_MANY = "reading refused: too many observations", "over 64 wait, or a step has over 32 new"
    MANY_SOURCES = "reading refused: too many sources", "over 16 new senders, or over 4 a minute"
    BEFORE_MAP = "reading before the map", "the robot has not published its map yet"
    CLOCK_RESTARTED = "clock restarted", "stamps jumped far back; the new time is used"
    ODOMETRY_JUMPED = "odometry jumped", "it was faster than 10 m/s or 10 rad/s: taken as no motion"
    ODOMETRY_CONTRADICTED = "odometry contradicted", "half of the particles move as scans show"
    LASER_SILENT = "laser silent", "no scan for more than 2 s by the stamps"
    ODOMETRY_SILENT = "odometry silent", "no odometry for more than 2 s by the stamps"
    OWN_ROBOT = "robot before its laser", "beams end on the robot itself; they are left out"
    BAD_QUESTION = "malformed question for scans", "a query that is not `scans?first=A;last=B`"
    SCAN_LATE = "scan repeated or late", "a step that was already decided"
    SCAN_AHEAD = "scan far ahead", "its step is over 10,000 above the newest one"
    STEPS_RESTARTED = "steps restarted", "step numbers begin again; the robot is searched for"
    OTHER_MAP = "scan of another map", "the bridge and this process have different maps"
    MAP_CHANGED = "map changed", "the bridge or the robot has another map, which is used now"
    OLD_EPOCH = "report of an old epoch", "a worker reports a job that was given to another"
    OTHER_JOB = "report of another worker's job", "a worker reports a cluster that it does not have"
    NO_ROOM = "report far ahead, or too many wait", "over 300 steps above the newest, or no room"
    LARGE_SNAPSHOT = "snapshot with too many particles", "a worker has more than the settings allow"
    TERM_RAISED = "term raised above a worker's", "no coordinator has the higher term of a worker"
    POSE_OFF_MAP = "pose off the map refused", "a given pose has no free ground within 3 sigma"
    OLD_FORMAT = "checkpoint that cannot be read", "an earlier coordinator's state is ignored"
    OLD_MAP = "checkpoint of another map", "an earlier coordinator's state is ignored"
    OLD_STEPS = "checkpoint of other step numbers", "an earlier coordinator's state is ignored"
    TOO_MANY_PROCESSES = "too many processes", "more than the status can list"
    NOT_RECORDED = "event not recorded", "the flight recorder could not write; the replay has a gap"
    ORDER_REFUSED = "order refused", "a worker cannot carry out an order: see its log"
    ORDER_OVERTAKEN = "order overtaken", "a worker has already carried out a newer order"
    OLD_TERM = "order of an old term", "a worker has an order of a replaced coordinator"
    ORDER_OTHER_MAP = "order for another map", "the bridge gave this worker another map"
    NO_HISTORY = "no scan history", "the bridge did not answer a worker's query for missed scans"
    NOT_ROS = "not a ROS message", "the bytes are not a message of the topic's type"
    CLOCK_SET_BACK = "clock set back", "`/clock` or tf went back: a bag or a simulation began again"
    TRANSFORM_REFUSED = "transform refused", "a transform in tf has an impossible number"
    LATE_TRANSFORM = "late transform", "a transform is older than all that tf keeps"
    OTHER_LOCALIZER = "map to odom from another node", "AMCL still runs, or a bag plays it"
    MAP_OTHER_FRAME = "map of another frame", "it is not in the frame `map`; it is used anyway"
    MAP_REFUSED = "map refused", "a map has an impossible size, cell or number"
    MAP_ODDS = "map of probabilities", "cells are between free and occupied; the map is used"
    POSE_REFUSED = "initial pose refused", "it is not in the frame `map`, or a number is impossible"
    ODOMETRY_REFUSED = "odometry refused", "a pose of the odometry is out of range"
    ADVICE = "advice", "the remark of an answer to a query for advice"
    NO_ADVICE = "no advice", "the coordinator or its worker did not answer"
    COMMAND_REFUSED = "command refused", "the coordinator refuses a command; the log has the reason"
    COMMAND_LOST = "command not carried out", "no coordinator answers: the system does not run"


AnyCause: TypeAlias = Cause | Named


def key_of(cause: AnyCause) -> str:
    """Return the name of a cause in `ClusterMCL.dropped`, such as ``no_odometry``."""
    key = cause.removeprefix("reading refused: ")
    return key.replace(" ", "_", -1 if isinstance(cause, Cause) else 1)
