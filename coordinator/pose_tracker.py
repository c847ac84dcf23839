"""The pose between steps: the best cluster's, carried forward by the newest odometry."""

import numpy as np
from msgspec.structs import replace

from coordinator.belief.outcome import Outcome
from coordinator.dead_reckoning import DeadReckoning, DrivenGates
from particle_filter.motion_noise import composed_covariance
from particle_filter.poses import compose
from particle_filter.settings import MotionSettings
from particle_filter.trajectory import Trajectory
from process_runtime.settings import BridgeSettings, CoordinatorSettings
from protocol.answers import Freshness, Hypothesis, PoseAnswer
from protocol.message import PoseTuple
from protocol.pose_arrays import covariance_matrix, covariance_tuple, pose_tuple

WINDOW_NS = 5_000_000_000
"""Usual is the promptest of the last one to two windows: clocks drift by microseconds a second."""
MOST_NS = 5_000_000_000
"""Nothing is held up for longer, links break before: such a delay is a clock that was set back."""


class LatencyEstimator:
    """Compares a robot's stamps with the time of their arrival; the clocks need not agree."""

    def __init__(self) -> None:
        self._begun_ns: int | None = None
        self._least_ns = self._least_before_ns = 0

    def of(self, stamp_ns: int, now_ns: int) -> int:
        """Return how much later this has arrived than the promptest recent data; never negative
        [ns].

        Args:
            stamp_ns: by the robot's clock.
            now_ns: time of arrival, by this process's clock.
        """
        delay_ns = now_ns - stamp_ns
        if self._begun_ns is None or delay_ns - self._usual_ns() > MOST_NS:
            self._begun_ns = now_ns
            self._least_ns = self._least_before_ns = delay_ns
        elif now_ns - self._begun_ns >= WINDOW_NS:
            self._begun_ns = now_ns
            self._least_before_ns, self._least_ns = self._least_ns, delay_ns
        self._least_ns = min(self._least_ns, delay_ns)
        return delay_ns - self._usual_ns()

    @property
    def usual_ns(self) -> int | None:
        """Delay from a stamp to a prompt arrival, by both clocks; None: nothing has arrived."""
        return None if self._begun_ns is None else self._usual_ns()

    def _usual_ns(self) -> int:
        return min(self._least_ns, self._least_before_ns)


MAX_WAITING_SCANS = 1_000
"""More scans than this have arrived and were not applied: those are not waited for."""


def recent_odometry() -> Trajectory:
    """Return a trajectory for the last five seconds or more: a given pose may be of that time.

    Between poses 0.1 s apart the robot goes straight. Before the oldest, that holds for a second: a
    client that gives a pose has another clock.
    """
    return Trajectory(most=51, every_ns=100_000_000, held_ns=1_000_000_000)


class PoseTracker:
    """The robot's present pose, and the age of the data behind it.

    Args:
        sender: name of the process.
        settings: when a pose is stale or dead reckoning.
        motion: how far odometry errs.
        bridge: its gate defines a step.
    """

    def __init__(
        self,
        sender: str,
        settings: CoordinatorSettings,
        motion: MotionSettings,
        bridge: BridgeSettings,
    ) -> None:
        self._sender = sender
        self._stale_after_s = settings.stale_after_s
        self._stale_ns = int(settings.stale_after_s * 1e9) + 1
        self._dead_reckoning_after_gates = settings.dead_reckoning_after_gates
        self._outcome: Outcome | None = None
        self._since_step, self._driven = DeadReckoning(motion, bridge), DrivenGates(bridge)
        self.history = recent_odometry()
        self._odom_now: PoseTuple = (0.0, 0.0, 0.0)
        self._stamp_ns = 0
        self._arrived_ns: int | None = None
        self._told_ns = 0
        """When another coordinator's state with the newest stamp arrived."""
        self._has_heard = False
        """Whether this coordinator has received data itself: only then the age of the rest is
        known.
        """
        self._waiting_ns: dict[int, int] = {}
        """By stamp, when scans arrived that are not applied yet."""
        self._scan_ns: int | None = None
        self._by_scan = True
        self._lateness: LatencyEstimator | None = None

    def use(self, motion: MotionSettings, bridge: BridgeSettings) -> None:
        """Continue with another motion model and another gate."""
        self._since_step.use(motion, bridge)
        self._driven.bridge = bridge

    @property
    def live(self) -> bool:
        """Whether stamps are of a clock that runs at the usual rate, as the newest scan says.

        Such stamps show how long the network has delayed data. Recordings may be played at any
        rate.
        """
        return self._lateness is not None

    def odometry(self, stamp_ns: int, odom_from_robot: PoseTuple, now_ns: int) -> None:
        """Take the robot's odometry; a repeated stamp is ignored: the robot's clock has stopped."""
        if self._has_heard and stamp_ns == self._stamp_ns:
            return
        is_known = self._arrived_ns is not None and stamp_ns == self._stamp_ns
        heard_ns = self._told_ns if is_known else now_ns  # others' data came before it
        self._has_heard = True
        late_ns = self._lateness.of(stamp_ns, heard_ns) if self._lateness else 0
        self._stamp_ns, self._odom_now = stamp_ns, odom_from_robot
        self.history.add(stamp_ns, odom_from_robot)
        self._arrived_ns = heard_ns - late_ns
        self._by_scan = False
        self._since_step.on_odometry(odom_from_robot)
        self._driven.on_odometry(odom_from_robot)

    def scan(
        self,
        stamp_ns: int,
        odom_from_robot: PoseTuple,
        now_ns: int,
        *,
        live: bool = False,
        fetched: bool = False,
    ) -> None:
        """Take a step's scan; it was taken before the newest odometry.

        A fetched scan says nothing of the network's delay and does not replace newer data. If it is
        the first data, the pose is stale.
        """
        if live != self.live:
            self._lateness = self._lateness_so_far() if live else None
        if fetched:
            self._heard_of(stamp_ns, odom_from_robot, now_ns - self._stale_ns, now_ns)
        elif self._by_scan or stamp_ns > self._stamp_ns:
            self.odometry(stamp_ns, odom_from_robot, now_ns)
            self._by_scan = True
        self._waiting_ns[stamp_ns] = self._taken_ns(stamp_ns, now_ns)
        if len(self._waiting_ns) > MAX_WAITING_SCANS:
            del self._waiting_ns[next(iter(self._waiting_ns))]

    def weighed(self, stamp_ns: int, odom_from_robot: PoseTuple) -> None:
        """Take that a scan was applied that at least one worker had weighed."""
        self._driven.begin_at(odom_from_robot)
        self._driven.on_odometry(self._odom_now)
        if stamp_ns in self._waiting_ns:
            self._scan_ns = self._waiting_ns[stamp_ns]
            while next(iter(self._waiting_ns)) != stamp_ns:
                del self._waiting_ns[next(iter(self._waiting_ns))]

    def believed(self, outcome: Outcome, odom_from_robot: PoseTuple) -> None:
        """Take the outcome of a step; its hypotheses hold at the odometry of its scan."""
        self._outcome = outcome
        self._since_step.begin_at(odom_from_robot)
        self._since_step.on_odometry(self._odom_now)

    def begin(self, usual_delay_ns: int, now_ns: int) -> None:
        """Use the delay [ns] with which a live robot's data reached other coordinators."""
        self._lateness = LatencyEstimator()
        self._lateness.of(now_ns - usual_delay_ns, now_ns)

    def resume(
        self,
        stamp_ns: int,
        odom_from_robot: PoseTuple,
        age_s: float,
        now_ns: int,
        *,
        live: bool = False,
    ) -> None:
        """Take what another coordinator has received.

        It counts as stale, unless `begin` or this coordinator's own data show when it arrived.
        """
        if live and not self.live:
            self._lateness = self._lateness_so_far()
        unless_known_ns = now_ns - int(max(age_s, 0.0) * 1e9) - self._stale_ns
        if self._arrived_ns is None:
            self._heard_of(stamp_ns, odom_from_robot, unless_known_ns, now_ns)
        due_ns = self._due_ns(stamp_ns, now_ns)
        self._scan_ns = unless_known_ns if due_ns is None else due_ns
        self._driven.begin_at(odom_from_robot)
        self._driven.on_odometry(self._odom_now)

    def _lateness_so_far(self) -> LatencyEstimator:
        """Of a robot that turns out to be live: the newest data counts if it came by itself."""
        lateness = LatencyEstimator()
        if self._has_heard and self._arrived_ns is not None:
            lateness.of(self._stamp_ns, self._arrived_ns)
        return lateness

    def _heard_of(
        self, stamp_ns: int, odom_from_robot: PoseTuple, unless_known_ns: int, now_ns: int
    ) -> None:
        """Take data that another coordinator received, unless newer data is known."""
        if self._arrived_ns is not None and stamp_ns <= self._stamp_ns:
            return
        self._stamp_ns, self._told_ns, self._odom_now = stamp_ns, now_ns, odom_from_robot
        self._since_step.on_odometry(odom_from_robot)
        self._driven.on_odometry(odom_from_robot)
        due_ns = self._due_ns(stamp_ns, now_ns)
        if due_ns is not None:
            self._arrived_ns = due_ns
        elif self._arrived_ns is None:
            self._arrived_ns = unless_known_ns

    def _due_ns(self, stamp_ns: int, now_ns: int) -> int | None:
        """Return when another coordinator must have received data of this stamp, if known."""
        usual_ns = self._lateness.usual_ns if self._lateness else None
        return None if usual_ns is None else min(stamp_ns + usual_ns, now_ns)

    @property
    def age_known(self) -> bool:
        """Whether this coordinator has received data itself."""
        return self._has_heard

    def age_s(self, now_ns: int) -> float:
        """Return the age of the newest data [s], as if it had come in time; -1 before any did."""
        return _since_s(self._arrived_ns, now_ns)

    def age_of_s(self, stamp_ns: int, now_ns: int) -> float:
        """Return the age of the data with this stamp [s], as if it had arrived in time.

        Of other sources than a live robot: the age of the newest data. -1 before any data arrived.
        """
        if self._arrived_ns is None or not self.live:
            return self.age_s(now_ns)
        return _since_s(self._taken_ns(stamp_ns, now_ns), now_ns)

    def answer(self, now_ns: int, workers: int) -> PoseAnswer:
        """The pose as it is now; after a gap in the data it is not `fresh`."""
        best = self._outcome.hypotheses[0] if self._outcome and self._outcome.hypotheses else None
        carried = self._carried(best) if best else None
        return PoseAnswer(
            sender=self._sender,
            state=self._outcome.state if self._outcome else "searching",
            freshness=self._freshness(now_ns, workers),
            stamp_ns=self._stamp_ns,
            age_s=self.age_s(now_ns),
            scan_age_s=_since_s(self._scan_ns, now_ns),
            step=self._outcome.step if self._outcome else -1,
            probability=best.probability if best else 0.0,
            map_from_robot=carried.mean if carried else None,
            covariance=carried.covariance if carried else None,
            workers=workers,
            elsewhere_probability=self._outcome.elsewhere_probability if self._outcome else 1.0,
            off_map_probability=self._outcome.off_map_probability if self._outcome else 0.0,
        )

    def hypotheses(self) -> tuple[Hypothesis, ...]:
        """All places, carried forward; most probable first."""
        known = self._outcome.hypotheses if self._outcome else ()
        return tuple(self._carried(hypothesis) for hypothesis in known)

    def _freshness(self, now_ns: int, workers: int) -> Freshness:
        if self._arrived_ns is None:
            return "none"
        if not 0.0 <= self.age_s(now_ns) <= self._stale_after_s:
            return "stale"
        if workers == 0 or self._driven.gates >= self._dead_reckoning_after_gates:
            return "dead_reckoning"
        return "fresh"

    def _taken_ns(self, stamp_ns: int, now_ns: int) -> int:
        """Return when a scan would have arrived in time; a live robot's stamps show its delay."""
        if self._lateness is None or self._arrived_ns is None:
            return now_ns
        return min(self._arrived_ns - (self._stamp_ns - stamp_ns), now_ns)

    def _carried(self, hypothesis: Hypothesis) -> Hypothesis:
        """A hypothesis moved by the odometry since its step, and less certain by its noise."""
        moved, noise = self._since_step.motion()
        mean = np.array(hypothesis.mean)
        covariance = composed_covariance(
            mean, covariance_matrix(hypothesis.covariance), moved, noise
        )
        return replace(
            hypothesis,
            mean=pose_tuple(compose(mean, moved)),
            covariance=covariance_tuple(covariance),
        )


def _since_s(then_ns: int | None, now_ns: int) -> float:
    return -1.0 if then_ns is None else (now_ns - then_ns) / 1e9
