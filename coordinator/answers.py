"""What the coordinator says to those who ask, and to everybody after a step."""

from collections import Counter

import msgspec

from coordinator.belief.outcome import belief_after
from coordinator.failover.term import Term
from coordinator.instructions import PublishBelief, PublishEvents
from coordinator.state import CoordinatorState
from protocol.answers import Belief, Hypotheses, PoseAnswer, Status
from protocol.job_events import JobEvents, NumberedEvent


class Answers:
    """Makes messages of what the coordinator knows.

    Args:
        sender: name of the process.
        version: of the software.
        state: of the coordinator.
        term: of the coordinator.
        now_ns: when it was started.
    """

    def __init__(
        self, sender: str, version: str, state: CoordinatorState, term: Term, now_ns: int
    ) -> None:
        self._sender, self._version, self._state, self._term = sender, version, state, term
        self._started_ns = now_ns

    def pose(self, now_ns: int) -> PoseAnswer:
        """Where the robot is now."""
        answer = self._state.pose.answer(now_ns, len(self._state.placement.delivery.workers))
        return msgspec.structs.replace(answer, term=self._term.number)

    def hypotheses(self, now_ns: int) -> Hypotheses:
        """All places with their probabilities."""
        return Hypotheses(
            sender=self._sender, pose=self.pose(now_ns), hypotheses=self._state.pose.hypotheses()
        )

    def status(self, now_ns: int, counters: dict[str, int]) -> Status:
        """How the system is; `counters` are those of the process around."""
        pose = self.pose(now_ns)
        return Status(
            sender=self._sender,
            version=self._version,
            state=pose.state,
            freshness=pose.freshness,
            age_s=pose.age_s,
            scan_age_s=pose.scan_age_s,
            step=pose.step,
            steps_applied=self._state.steps_applied,
            steps_lost=self._state.collector.steps_lost,
            reports_missing=self._state.reports_missing,
            map_digest=self._state.map_digest,
            clusters=len(self._state.ensemble.clusters),
            searching=self._state.outcome.searching if self._state.outcome else False,
            search_progress=self._state.outcome.search_progress if self._state.outcome else 0.0,
            workers=self._state.placement.workers,
            counters=dict(sorted((self._state.counters + Counter(counters)).items())),
            uptime_s=(now_ns - self._started_ns) / 1e9,
            term=self._term.number,
            newest_step=self._state.newest_step,
            settings=self._state.newest_settings,
            overloaded=self._state.overload.is_overloaded,
        )

    def events(self) -> JobEvents:
        """What has begun and ended of late, and why."""
        return self._told(self._state.event_log.all())

    def publication(self, now_ns: int) -> list[PublishEvents | PublishBelief]:
        """What everybody is told after a step or a command; nothing before the first.

        What has begun and ended is told before the belief it belongs to.
        """
        belief = self._belief()
        if belief is None:
            return []
        news = self._state.event_log.news()
        told = [PublishEvents(self._told(news))] if news else []
        return [*told, PublishBelief(belief, self.pose(now_ns))]

    def _told(self, events: tuple[NumberedEvent, ...]) -> JobEvents:
        return JobEvents(sender=self._sender, events=events, term=self._term.number)

    def _belief(self) -> Belief | None:
        """What is believed after the last step or command; None before the first."""
        outcome, scan = self._state.outcome, self._state.collector.applied
        if outcome is None or scan is None:
            return None
        return belief_after(scan, outcome, self._sender, self._term.number)
