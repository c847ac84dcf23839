"""From readings to steps: checked, synchronised, gated and numbered. No clock, no network."""

from collections import Counter, deque
from collections.abc import Iterable, Iterator

import msgspec

from particle_filter.settings import section_with
from particle_filter.trajectory import Trajectory
from process_runtime.settings import BridgeSettings
from protocol.live_settings import AS_STARTED, LiveSettings
from protocol.message import PoseTuple
from protocol.reading_checks import laser_problem, odometry_problem
from protocol.steps import LaserReading, OdometryReading, Reading, Scan
from sensor_bridge.laser_inputs import LaserInputs, beams_of
from sensor_bridge.motion_gate import MotionGate
from sensor_bridge.odometry_continuity import OdometryContinuity
from sensor_bridge.outlier_filter import MAX_STEP_BACK_NS, OutlierFilter

STAMP_STEPS_BACK = "stamp_steps_back"
CLOCK_RESTARTED = "clock_restarted"
NO_ODOMETRY = "no_odometry"
ODOMETRY_JUMPED = "odometry_jumped"
OUTLIER = "strayed_in_time_or_place"
TOO_MANY_LASERS = "too_many_lasers"

MAX_WAITING_SCANS = 8
"""Scans of a laser that wait for later odometry; one more, and the first makes do with what there
is."""
RESTART_AFTER = 20
"""So many readings in a row from the past are no late ones: the clock was set back."""


class StepMaker:
    """Makes numbered steps of a robot's readings.

    A scan that does not bring its odometry along waits for the first odometry after it, so that
    `take` may answer an odometry reading with a scan taken before.

    Odometry is handed on in a frame that does not jump, see `OdometryContinuity`.

    Of several lasers, the first scan that the gate lets through makes a step, and the newest scans
    of the others join it. Only odometry and one laser, the first that is heard, can show that the
    robot's clock was set or its odometry began anew; what another laser sends that does not fit is
    an outlier, and disturbs nobody. When the first falls silent, another comes in its place.

    Args:
        settings: the motion gate.
        map_digest: put into every step, for those who have another map to notice.
        sender: put into every step.
        first_step: number of the first step.
        paced: put into every step: the sender waits for the belief before it sends the next.
        live: put into every step: stamps are of a robot's own clock.

    Attributes:
        dropped: readings that were not used, by cause; jumps of odometry and restarts of the
            clock are counted here too. Scans that the gate held back are not.
    """

    def __init__(
        self,
        settings: BridgeSettings,
        map_digest: str,
        sender: str,
        first_step: int = 0,
        paced: bool = False,
        live: bool = False,
    ) -> None:
        self.dropped: Counter[str] = Counter()
        self._map_digest, self._sender = map_digest, sender
        self._paced, self._live = paced, live
        self._next_step = first_step
        self._settings, self._live_settings = settings, AS_STARTED
        self._gate = MotionGate(settings)
        self._buffer, self._continuity = Trajectory(most=200), OdometryContinuity()
        self._lasers = LaserInputs()
        self._first_laser: str | None = None
        self._strayed_in_a_row = 0
        self._ready: deque[Scan] = deque()
        self._newest_ns: int | None = None
        self._late_in_a_row = 0
        self._outliers = OutlierFilter()
        self._odometry: tuple[int, PoseTuple] | None = None

    @property
    def odometry(self) -> tuple[int, PoseTuple] | None:
        """Stamp and pose of the newest odometry, in the same frame as that of the steps."""
        return self._odometry

    def on_reading(self, reading: Reading) -> Scan | None:
        """Take the next reading; the next step, if there is one."""
        if problem := _problem(reading) or self._problem_of_other_laser(reading):
            self.dropped[problem] += 1
        elif self._is_of_other_laser(reading):
            self._use([reading])
        else:
            usual, outliers = self._outliers.sifted(reading, self._newest_ns)
            self.dropped.update({OUTLIER: len(outliers)} if outliers else {})
            self._use(usual)
        return self._ready.popleft() if self._ready else None

    def finish(self) -> Scan | None:
        """No reading follows: what still waits makes do. Call it until it answers None."""
        self._use(self._outliers.released())
        self._release(at_most_waiting=0)
        return self._ready.popleft() if self._ready else None

    @property
    def held_back(self) -> int:
        """Scans that were no steps because of `hold`."""
        return self._gate.held_back

    def hold(self, is_held: bool) -> None:
        """Make no steps for the time being: those that are made already are too many."""
        self._gate.is_held = is_held

    def configure(self, live: LiveSettings) -> None:
        """Let these settings hold from the next step on."""
        self._live_settings = live
        self._gate.settings = section_with(self._settings, live)

    def force_next(self) -> None:
        """Let the next usable scan become a step, however little the robot has moved."""
        self._gate.open_next()

    @property
    def stands(self) -> bool:
        """Whether the robot still is where it was at the last step."""
        return self._odometry is not None and self._gate.has_hardly_moved(self._odometry[1])

    def change_map(self, map_digest: str) -> None:
        """Steps are of another map from now on; the next scan becomes the first of them."""
        self._map_digest = map_digest
        self._gate.begin_anew()

    def resume(self, last: Scan, odometry: tuple[int, PoseTuple]) -> None:
        """Continue after a step of an earlier process.

        Args:
            last: that step.
            odometry: what `odometry` was then.
        """
        self._next_step = last.step + 1
        self._gate.resume(last.odom_from_robot)
        for stamp_ns, pose in ((last.stamp_ns, last.odom_from_robot), odometry):
            self._take_odometry_pose(stamp_ns, pose)

    def _is_of_other_laser(self, reading: Reading) -> bool:
        if isinstance(reading, OdometryReading):
            return False
        if self._first_laser is None:
            self._first_laser = reading.laser
        return reading.laser != self._first_laser

    def _problem_of_other_laser(self, reading: Reading) -> str | None:
        """Why a scan of a laser other than the first cannot be used."""
        if isinstance(reading, LaserReading) and self._lasers.is_full_for(reading.laser):
            return TOO_MANY_LASERS
        if not self._is_of_other_laser(reading):
            self._strayed_in_a_row = 0
            return None
        newest_ns = reading.stamp_ns if self._newest_ns is None else self._newest_ns
        in_time = abs(reading.stamp_ns - newest_ns) <= MAX_STEP_BACK_NS
        if in_time and not self._outliers.jumps(reading):
            return None
        self._strayed_in_a_row += 1
        if self._strayed_in_a_row < RESTART_AFTER:
            return OUTLIER
        assert isinstance(reading, LaserReading)
        self._first_laser, self._strayed_in_a_row = reading.laser, 0
        return None

    def _use(self, readings: Iterable[Reading]) -> None:
        for reading in readings:
            if isinstance(reading, OdometryReading):
                self._take_odometry(reading)
            else:
                self._take_laser(reading)

    def _take_odometry(self, reading: OdometryReading) -> None:
        self._take_odometry_pose(reading.stamp_ns, reading.odom_from_robot)

    def _take_odometry_pose(self, stamp_ns: int, odom_from_robot: PoseTuple) -> None:
        pose = self._without_jump(stamp_ns, odom_from_robot)
        if self._in_time(stamp_ns):
            self._buffer.add(stamp_ns, pose)
            self._note_odometry(stamp_ns, pose)
            self._release()

    def _take_laser(self, reading: LaserReading) -> None:
        pose = None
        if reading.odom_from_robot is not None:
            pose = self._without_jump(reading.stamp_ns, reading.odom_from_robot)
        if self._in_time(reading.stamp_ns):
            self._lasers.of(reading.laser).waiting.append((reading, pose))
            if pose is not None:
                self._note_odometry(reading.stamp_ns, pose)
            self._release()

    def _without_jump(self, stamp_ns: int, odom_from_robot: PoseTuple) -> PoseTuple:
        if self._continuity.jumped(stamp_ns, odom_from_robot):
            self.dropped[ODOMETRY_JUMPED] += 1
        return self._continuity.continuous(odom_from_robot)

    def _note_odometry(self, stamp_ns: int, pose: PoseTuple) -> None:
        if self._odometry is None or stamp_ns >= self._odometry[0]:
            self._odometry = (stamp_ns, pose)

    def _in_time(self, stamp_ns: int) -> bool:
        """Whether a reading is no more than a little late; if none is, the clock was set back."""
        if self._newest_ns is None or stamp_ns >= self._newest_ns - MAX_STEP_BACK_NS:
            self._newest_ns = (
                stamp_ns if self._newest_ns is None else max(stamp_ns, self._newest_ns)
            )
            self._late_in_a_row = 0
            return True
        self._late_in_a_row += 1
        if self._late_in_a_row < RESTART_AFTER:
            self.dropped[STAMP_STEPS_BACK] += 1
            return False
        self.dropped[CLOCK_RESTARTED] += 1
        self._release(at_most_waiting=0)
        self._buffer.clear()
        self._newest_ns, self._odometry, self._late_in_a_row = stamp_ns, None, 0
        return True

    def _release(self, at_most_waiting: int = MAX_WAITING_SCANS) -> None:
        """Make steps of the scans whose odometry is known, in the order of their arrival."""
        for laser in self._lasers:
            while laser.waiting:
                reading, pose = laser.waiting[0]
                known = pose is not None or self._buffer.reaches(reading.stamp_ns)
                if not known and len(laser.waiting) <= at_most_waiting:
                    break
                laser.waiting.popleft()
                pose = pose or self._buffer.pose_at(reading.stamp_ns)
                if pose is None:
                    self.dropped[NO_ODOMETRY] += 1
                else:
                    self._take_scan(reading, pose)

    def _take_scan(self, reading: LaserReading, odom_from_robot: PoseTuple) -> None:
        if self._gate.on_scan(odom_from_robot):
            self._ready.append(self._step(reading, odom_from_robot))
        else:
            self._lasers.hold(reading, odom_from_robot)

    def _step(self, reading: LaserReading, odom_from_robot: PoseTuple) -> Scan:
        beams = beams_of(reading)
        self._next_step += 1
        return Scan(
            sender=self._sender,
            step=self._next_step - 1,
            stamp_ns=reading.stamp_ns,
            odom_from_robot=odom_from_robot,
            robot_from_laser=beams.robot_from_laser,
            angle_min_rad=beams.angle_min_rad,
            angle_step_rad=beams.angle_step_rad,
            range_max_m=beams.range_max_m,
            ranges=beams.ranges,
            map_digest=self._map_digest,
            paced=self._paced,
            live=self._live,
            others=self._lasers.used_for(reading, odom_from_robot),
            settings=self._live_settings,
        )


def steps_from(readings: Iterable[Reading], maker: StepMaker) -> Iterator[Scan]:
    """All steps of readings that come to an end; the last one says so."""
    held: Scan | None = None
    for scan in _steps(readings, maker):
        if held is not None:
            yield held
        held = scan
    if held is not None:
        yield msgspec.structs.replace(held, last=True)


def _problem(reading: Reading) -> str | None:
    if isinstance(reading, OdometryReading):
        return odometry_problem(reading)
    return laser_problem(reading)


def _steps(readings: Iterable[Reading], maker: StepMaker) -> Iterator[Scan]:
    for reading in readings:
        if (scan := maker.on_reading(reading)) is not None:
            yield scan
    while (scan := maker.finish()) is not None:
        yield scan
