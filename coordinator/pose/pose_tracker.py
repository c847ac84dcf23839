"""The pose between steps: the best cluster's, carried forward by the newest odometry."""

import math

import numpy as np

from coordinator.belief.outcome import Outcome
from coordinator.pose.lateness import Lateness
from particle_filter.poses import between, compose
from protocol.answers import Hypothesis, PoseAnswer
from protocol.message import PoseTuple
from protocol.pose_arrays import covariance_matrix, covariance_tuple, pose_tuple


class PoseTracker:
    """Answers where the robot is now, and how old the data is that says so.

    Args:
        sender: name of the process.
        stale_after_s: older data is not called fresh.
    """

    def __init__(self, sender: str, stale_after_s: float) -> None:
        self._sender, self._stale_after_s = sender, stale_after_s
        self._outcome: Outcome | None = None
        self._odom_at_step: PoseTuple = (0.0, 0.0, 0.0)
        self._odom_now: PoseTuple = (0.0, 0.0, 0.0)
        self._stamp_ns = 0
        self._arrived_ns: int | None = None
        self._by_scan = True
        self._lateness: Lateness | None = None

    @property
    def live(self) -> bool:
        """Whether stamps are of a clock that runs like any other, as the newest scan said.

        They tell what the network has held up; those of a recording run as fast as it is played.
        """
        return self._lateness is not None

    def odometry(self, stamp_ns: int, odom_from_robot: PoseTuple, now_ns: int) -> None:
        """The robot's odometry arrived; the same stamp again is no news: its clock stands."""
        if self._arrived_ns is not None and stamp_ns == self._stamp_ns:
            return
        late_ns = self._lateness.of(stamp_ns, now_ns) if self._lateness else 0
        self._stamp_ns, self._odom_now = stamp_ns, odom_from_robot
        self._arrived_ns = now_ns - late_ns
        self._by_scan = False

    def scan(
        self, stamp_ns: int, odom_from_robot: PoseTuple, now_ns: int, *, live: bool = False
    ) -> None:
        """A step's scan arrived; it was taken before the newest odometry, where there is any."""
        if live != self.live:
            self._lateness = Lateness() if live else None
        if self._by_scan or stamp_ns > self._stamp_ns:
            self.odometry(stamp_ns, odom_from_robot, now_ns)
            self._by_scan = True

    def believed(self, outcome: Outcome, odom_from_robot: PoseTuple) -> None:
        """A step was applied; its hypotheses hold at the odometry of its scan."""
        self._outcome, self._odom_at_step = outcome, odom_from_robot

    def resume(
        self,
        stamp_ns: int,
        odom_from_robot: PoseTuple,
        age_s: float,
        now_ns: int,
        *,
        live: bool = False,
    ) -> None:
        """Another coordinator has heard this, and nobody knows how long ago: it is stale."""
        if live and not self.live:
            self._lateness = Lateness()
        if self._arrived_ns is None:
            self._stamp_ns, self._odom_now = stamp_ns, odom_from_robot
            self._arrived_ns = now_ns - int((max(age_s, 0.0) + self._stale_after_s) * 1e9) - 1

    def age_s(self, now_ns: int) -> float:
        """Since the newest data arrived, or would have in time [s]; -1 before any did."""
        return -1.0 if self._arrived_ns is None else (now_ns - self._arrived_ns) / 1e9

    def answer(self, now_ns: int, workers: int) -> PoseAnswer:
        """The pose as it is now; a gap in the data makes it stale, never fresh."""
        age_s = self.age_s(now_ns)
        best = self._outcome.hypotheses[0] if self._outcome and self._outcome.hypotheses else None
        carried = self._carried(best) if best else None
        fresh = 0.0 <= age_s <= self._stale_after_s
        return PoseAnswer(
            sender=self._sender,
            state=self._outcome.state if self._outcome else "searching",
            freshness="none" if self._arrived_ns is None else "fresh" if fresh else "stale",
            stamp_ns=self._stamp_ns,
            age_s=age_s,
            step=self._outcome.step if self._outcome else -1,
            probability=best.probability if best else 0.0,
            map_from_robot=carried.mean if carried else None,
            covariance=carried.covariance if carried else None,
            workers=workers,
        )

    def hypotheses(self) -> tuple[Hypothesis, ...]:
        """All places, carried forward; most probable first."""
        known = self._outcome.hypotheses if self._outcome else ()
        return tuple(self._carried(hypothesis) for hypothesis in known)

    def _carried(self, hypothesis: Hypothesis) -> Hypothesis:
        """A hypothesis moved by the odometry since its step, its covariance by first order."""
        moved = between(np.array(self._odom_at_step), np.array(self._odom_now))
        mean = compose(np.array(hypothesis.mean), moved)
        heading = hypothesis.mean[2]
        jacobian = np.eye(3)
        jacobian[0, 2] = -moved[0] * math.sin(heading) - moved[1] * math.cos(heading)
        jacobian[1, 2] = moved[0] * math.cos(heading) - moved[1] * math.sin(heading)
        covariance = jacobian @ covariance_matrix(hypothesis.covariance) @ jacobian.T
        return Hypothesis(
            cluster=hypothesis.cluster,
            probability=hypothesis.probability,
            log_probability=hypothesis.log_probability,
            mean=pose_tuple(mean),
            covariance=covariance_tuple(covariance),
            effective_sample_size=hypothesis.effective_sample_size,
            age_steps=hypothesis.age_steps,
        )
