"""What the belief comes to after a step, and how places are told."""

from dataclasses import dataclass

from coordinator.belief.cluster_set import Cluster
from protocol.answers import Hypothesis, State
from protocol.job_events import Began, Ended, JobEvent
from protocol.work import Job


@dataclass(frozen=True)
class Outcome:
    """What one step, or one command, came to."""

    step: int
    state: State
    hypotheses: tuple[Hypothesis, ...]
    """Most probable first; with `elsewhere_probability` they sum to one."""
    elsewhere_probability: float
    """That the robot is at none of them."""
    searching: bool
    missing: tuple[str, ...]
    begin: dict[str, Job]
    """Jobs that begin after `step`, by job id."""
    events: tuple[JobEvent, ...]
    """Which clusters have begun, which clusters and searches ended, and why; as it was decided."""

    search_progress: float = 0.0
    """How near the search that runs is to its end, 0 to 1."""
    off_map_probability: float = 0.0
    """Of `elsewhere_probability`, that the robot is not on the map at all."""

    @property
    def end(self) -> tuple[str, ...]:
        """Jobs that end. A cluster that begins and ends in the same step never had a job."""
        begun = {event.job_id for event in self.events if isinstance(event, Began)}
        ended = (event.job_id for event in self.events if isinstance(event, Ended))
        return tuple(job_id for job_id in ended if job_id not in begun)


def hypothesis_of(cluster: Cluster, step: int) -> Hypothesis:
    """A tracked place as it is told."""
    return Hypothesis(
        cluster=cluster.cluster,
        probability=cluster.probability,
        log_probability=cluster.log_probability,
        mean=cluster.mean,
        covariance=cluster.covariance,
        effective_sample_size=cluster.effective_sample_size,
        age_steps=step - cluster.born_step,
    )
