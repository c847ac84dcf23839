"""The pose between steps: the best cluster's, carried forward by the newest odometry."""

from msgspec import field
from msgspec.structs import replace

from clustermcl.belief.dead_reckoning import DeadReckoning, moved_by
from clustermcl.belief.outcome import BEFORE_FIRST_STEP, Outcome
from clustermcl.belief.part import Part
from clustermcl.filter.motion.trajectory import Trajectory
from clustermcl.protocol.answers import Freshness, Hypothesis, PoseAnswer
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import Scan
from clustermcl.runtime.settings import CoordinatorSettings

WINDOW_NS = 5_000_000_000
"""The usual delay is the least of one to two windows: clocks drift by microseconds a second."""
MOST_NS = 5_000_000_000
"""A longer delay shows that a clock was set back: links break before data is so late [ns]."""


class LatencyEstimator(Part):
    """Compares a robot's stamps with times of arrival; the clocks need not agree."""

    begun_ns: int | None = None
    """Start of the present window [ns]; None: nothing has arrived."""
    least_ns: int = 0
    """Least delay of the present window [ns]."""
    least_before_ns: int = 0
    """Least delay of the window before [ns]."""

    @property
    def usual_ns(self) -> int | None:
        """Least recent difference between arrival and stamp [ns]; None: nothing has arrived."""
        return None if self.begun_ns is None else min(self.least_ns, self.least_before_ns)

    def on_arrival(self, stamp_ns: int, now_ns: int) -> int:
        """Record an arrival; return by how much it is later than usual, never negative [ns]."""
        delay_ns, usual_ns = now_ns - stamp_ns, self.usual_ns
        if self.begun_ns is None or usual_ns is None or delay_ns - usual_ns > MOST_NS:
            self.begun_ns = now_ns
            self.least_ns = self.least_before_ns = delay_ns
        elif now_ns - self.begun_ns >= WINDOW_NS:
            self.begun_ns = now_ns
            self.least_before_ns, self.least_ns = self.least_ns, delay_ns
        self.least_ns = min(self.least_ns, delay_ns)
        return delay_ns - min(self.least_ns, self.least_before_ns)


MAX_WAITING_SCANS = 1_000
"""Largest number of scans, not applied yet, whose times of arrival are kept."""


def recent_odometry() -> Trajectory:
    """Return an empty trajectory that keeps at least five seconds, for poses that clients give.

    Its poses are 0.1 s apart. The oldest pose is also used for the second before it, because
    clocks of clients may differ.
    """
    return Trajectory(most=51, every_ns=100_000_000, held_ns=1_000_000_000)


class PoseTracker(Part):
    """The robot's present pose, and the age of the data behind it."""

    sender: str
    settings: CoordinatorSettings
    """Limits after which a pose is stale or dead reckoning."""
    since_step: DeadReckoning
    history: Trajectory = field(default_factory=recent_odometry)
    outcome: Outcome = BEFORE_FIRST_STEP
    """Result of the last step or command."""
    stamp_ns: int = 0
    """Stamp of the newest data [ns]."""
    arrived_ns: int | None = None
    """When the newest data would have arrived in time [ns]; None: no data arrived."""
    indirect_ns: int = 0
    """When data of the newest stamp arrived in another coordinator's state or in a fetched scan
    [ns]."""
    age_known: bool = False
    """Whether this coordinator has received odometry or a scan directly."""
    waiting_ns: dict[int, int] = {}
    """Times of arrival of scans that are not applied yet, by stamp [ns]."""
    scan_ns: int | None = None
    """When the last weighed scan would have arrived in time [ns]; None: no scan was weighed."""
    by_scan: bool = True
    """Whether the newest odometry came with a scan."""
    lateness: LatencyEstimator | None = None
    """None: the data does not come from a live robot."""

    @property
    def _stale_ns(self) -> int:
        return int(self.settings.stale_after_s * 1e9) + 1

    @property
    def live(self) -> bool:
        """Whether stamps run at the usual rate, so that they show delays of the network.

        Recordings may be played at any rate.
        """
        return self.lateness is not None

    @property
    def is_age_guessed(self) -> bool:
        """Whether all data came from another coordinator's state or in fetched scans."""
        return self.arrived_ns is not None and not self.age_known

    def odometry(self, stamp_ns: int, odom_from_robot: PoseTuple, now_ns: int) -> None:
        """Process odometry; ignore a repeated stamp, because the robot's clock has stopped."""
        if self.age_known and stamp_ns == self.stamp_ns:
            return
        is_known = self.arrived_ns is not None and stamp_ns == self.stamp_ns
        received_ns = self.indirect_ns if is_known else now_ns
        self.age_known = True
        late_ns = self.lateness.on_arrival(stamp_ns, received_ns) if self.lateness else 0
        self.stamp_ns = stamp_ns
        self.history.add(stamp_ns, odom_from_robot)
        self.arrived_ns = received_ns - late_ns
        self.by_scan = False
        self.since_step.on_odometry(odom_from_robot)

    def scan(self, scan: Scan, now_ns: int, *, fetched: bool = False) -> None:
        """Process the scan of a step.

        A fetched scan does not show the network's delay, and does not replace newer data. If it is
        the first data, the pose is stale.
        """
        if scan.live != self.live:
            self.lateness = self._lateness_so_far() if scan.live else None
        if fetched:
            self._on_indirect_data(scan, now_ns - self._stale_ns, now_ns)
        elif self.by_scan or scan.stamp_ns > self.stamp_ns:
            self.odometry(scan.stamp_ns, scan.odom_from_robot, now_ns)
            self.by_scan = True
        self.waiting_ns[scan.stamp_ns] = self._taken_ns(scan.stamp_ns, now_ns)
        if len(self.waiting_ns) > MAX_WAITING_SCANS:
            del self.waiting_ns[next(iter(self.waiting_ns))]

    def weighed(self, scan: Scan) -> None:
        """Record that a scan was applied and that at least one worker had weighed it."""
        self.since_step.weighed_at(scan.odom_from_robot)
        if scan.stamp_ns in self.waiting_ns:
            self.scan_ns = self.waiting_ns[scan.stamp_ns]
            while next(iter(self.waiting_ns)) != scan.stamp_ns:
                del self.waiting_ns[next(iter(self.waiting_ns))]

    def believed(self, outcome: Outcome, odom_from_robot: PoseTuple) -> None:
        """Store the outcome of a step, whose hypotheses refer to the odometry of the scan."""
        self.outcome = outcome
        self.since_step.begin_at(odom_from_robot)

    def resume(self, applied: Scan, age_s: float, now_ns: int) -> None:
        """Continue with the last scan that another coordinator applied.

        The data is stale, unless the usual delay is known: then its stamp shows when it arrived.
        """
        if applied.live and not self.live:
            self.lateness = self._lateness_so_far()
        unless_known_ns = now_ns - int(max(age_s, 0.0) * 1e9) - self._stale_ns
        if self.arrived_ns is None:
            self._on_indirect_data(applied, unless_known_ns, now_ns)
        due_ns = self._due_ns(applied.stamp_ns, now_ns)
        self.scan_ns = unless_known_ns if due_ns is None else due_ns
        self.since_step.weighed_at(applied.odom_from_robot)

    def _lateness_so_far(self) -> LatencyEstimator:
        """Return an estimator that begins with the newest data, if its arrival is known."""
        lateness = LatencyEstimator()
        if self.age_known and self.arrived_ns is not None:
            lateness.on_arrival(self.stamp_ns, self.arrived_ns)
        return lateness

    def _on_indirect_data(self, scan: Scan, unless_known_ns: int, now_ns: int) -> None:
        """Store data of a fetched scan or another coordinator's state, unless newer is known."""
        if self.arrived_ns is not None and scan.stamp_ns <= self.stamp_ns:
            return
        self.stamp_ns, self.indirect_ns = scan.stamp_ns, now_ns
        self.since_step.on_odometry(scan.odom_from_robot)
        due_ns = self._due_ns(scan.stamp_ns, now_ns)
        if due_ns is not None:
            self.arrived_ns = due_ns
        elif self.arrived_ns is None:
            self.arrived_ns = unless_known_ns

    def _due_ns(self, stamp_ns: int, now_ns: int) -> int | None:
        """Return when data of this stamp arrives by the usual delay; None: that is unknown."""
        usual_ns = self.lateness.usual_ns if self.lateness else None
        return None if usual_ns is None else min(stamp_ns + usual_ns, now_ns)

    def age_s(self, now_ns: int) -> float:
        """Return the age of the newest data [s], as if it had arrived in time; -1: no data yet."""
        return _since_s(self.arrived_ns, now_ns)

    def age_of_s(self, stamp_ns: int, now_ns: int) -> float:
        """Return the age of data with this stamp [s], as if it had arrived in time.

        Without a live robot: the age of the newest data. -1 before any data arrived.
        """
        if self.arrived_ns is None or not self.live:
            return self.age_s(now_ns)
        return _since_s(self._taken_ns(stamp_ns, now_ns), now_ns)

    def answer(self, now_ns: int, workers: int) -> PoseAnswer:
        """Return the present pose and its freshness; `workers`: number of live workers."""
        outcome = self.outcome
        best = self._carried(outcome.hypotheses[0]) if outcome.hypotheses else None
        return PoseAnswer(
            sender=self.sender,
            state=outcome.state,
            freshness=self._freshness(now_ns, workers),
            stamp_ns=self.stamp_ns,
            age_s=self.age_s(now_ns),
            scan_age_s=_since_s(self.scan_ns, now_ns),
            step=outcome.step,
            probability=best.probability if best else 0.0,
            pose=best.pose if best else None,
            covariance=best.covariance if best else None,
            workers=workers,
            elsewhere_probability=outcome.elsewhere_probability,
            off_map_probability=outcome.off_map_probability,
        )

    def hypotheses(self) -> tuple[Hypothesis, ...]:
        """Return all hypotheses, moved by the odometry since; most probable first."""
        return tuple(map(self._carried, self.outcome.hypotheses))

    def _freshness(self, now_ns: int, workers: int) -> Freshness:
        if self.arrived_ns is None:
            return "none"
        if not 0.0 <= self.age_s(now_ns) <= self.settings.stale_after_s:
            return "stale"
        is_far = self.since_step.gates >= self.settings.dead_reckoning_after_gates
        return "dead_reckoning" if workers == 0 or is_far else "fresh"

    def _taken_ns(self, stamp_ns: int, now_ns: int) -> int:
        """Return when a scan would have arrived without delay, by a live robot's stamp."""
        if self.lateness is None or self.arrived_ns is None:
            return now_ns
        return min(self.arrived_ns - (self.stamp_ns - stamp_ns), now_ns)

    def _carried(self, hypothesis: Hypothesis) -> Hypothesis:
        """Return a hypothesis moved by the odometry since its step, with the motion's noise."""
        moved = self.since_step.moved()
        pose, covariance = moved_by(hypothesis.pose, hypothesis.covariance, *moved)
        return replace(hypothesis, pose=pose, covariance=covariance)


def _since_s(then_ns: int | None, now_ns: int) -> float:
    return -1.0 if then_ns is None else (now_ns - then_ns) / 1e9
