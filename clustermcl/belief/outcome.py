"""The result of a step, and the messages that publish it."""

import math

import msgspec

from clustermcl.belief.cluster_set import Cluster
from clustermcl.protocol.answers import Belief, Hypothesis, State
from clustermcl.protocol.job_events import Began, Ended, JobEvent
from clustermcl.protocol.steps import Scan
from clustermcl.protocol.why import Why
from clustermcl.protocol.work import Job


class Outcome(msgspec.Struct, frozen=True):
    """The result of one step or one command."""

    step: int
    state: State
    hypotheses: tuple[Hypothesis, ...]
    """Most probable first; their probabilities and `elsewhere_probability` sum to one."""
    elsewhere_probability: float
    """Probability that the robot is at none of the hypotheses."""
    searching: bool
    missing: tuple[str, ...]
    begin: dict[str, Job]
    """Jobs that begin after `step`, by job id."""
    events: tuple[JobEvent, ...]
    """Clusters that began, clusters and searches that ended, and causes, in order of decision."""

    search_progress: float = 0.0
    """Progress of the current search, 0 to 1."""
    resize: dict[str, tuple[int, int]] = {}
    """By job id: new number of particles, and the first step that may resample to it."""
    off_map_probability: float = 0.0
    """Part of `elsewhere_probability`: the robot is not on the map."""
    why: Why = Why()
    """What changed the probabilities in the step; empty after a command."""

    @property
    def end(self) -> tuple[str, ...]:
        """Jobs that end. A cluster that begins and ends in the same step never had a job."""
        begun = {event.job_id for event in self.events if isinstance(event, Began)}
        ended = (event.job_id for event in self.events if isinstance(event, Ended))
        return tuple(job_id for job_id in ended if job_id not in begun)


BEFORE_FIRST_STEP = Outcome(
    step=-1,
    state="searching",
    hypotheses=(),
    elsewhere_probability=1.0,
    searching=False,
    missing=(),
    begin={},
    events=(),
)


def belief_after(scan: Scan, outcome: Outcome, sender: str, term: int = 0) -> Belief:
    """Return the belief message after a scan, or after a command that followed it."""
    places = tuple(map(scan.floors.place, outcome.hypotheses))
    return Belief(
        sender=sender,
        step=outcome.step,
        stamp_ns=scan.stamp_ns,
        odom_from_robot=scan.odom_from_robot,
        state=outcome.state,
        hypotheses=places,
        searching=outcome.searching,
        missing=outcome.missing,
        last=scan.last,
        term=term,
        elsewhere_probability=outcome.elsewhere_probability,
        off_map_probability=outcome.off_map_probability,
        search_progress=outcome.search_progress,
        floors=scan.floors.probabilities(places),
        why=outcome.why,
    )


def hypothesis_of(cluster: Cluster, log_probability: float, step: int) -> Hypothesis:
    return Hypothesis(
        cluster=cluster.cluster,
        probability=math.exp(log_probability),
        log_probability=log_probability,
        pose=cluster.pose,
        covariance=cluster.covariance,
        effective_sample_size=cluster.effective_sample_size,
        age_steps=step - cluster.born_step,
    )
