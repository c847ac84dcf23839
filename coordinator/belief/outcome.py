"""What the belief comes to after a step, and how places are told."""

import math
from dataclasses import dataclass

from coordinator.belief.cluster_set import Cluster
from coordinator.belief.search_pool import Pool
from protocol.answers import Hypothesis, State
from protocol.job_events import Ended, JobEvent
from protocol.work import SearchJob, TrackJob

Job = TrackJob | SearchJob


@dataclass(frozen=True)
class Outcome:
    """What one step, or one command, came to."""

    step: int
    state: State
    hypotheses: tuple[Hypothesis, ...]
    """Most probable first; while searching at the start, the places the search holds possible."""
    searching: bool
    missing: tuple[str, ...]
    begin: dict[str, Job]
    """Jobs that begin after `step`, by job id."""
    events: tuple[JobEvent, ...]
    """Which clusters have begun, which clusters and searches ended, and why; as it was decided."""

    @property
    def end(self) -> tuple[str, ...]:
        """Jobs that end."""
        return tuple(event.job_id for event in self.events if isinstance(event, Ended))


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


def places_of(pool: Pool) -> tuple[Hypothesis, ...]:
    """The places of a search that still runs; they are no clusters yet, so numbers are negative."""
    total = math.fsum(place.share for place in pool.places)
    return tuple(
        Hypothesis(
            cluster=-1 - index,
            probability=place.share / total,
            log_probability=math.log(place.share / total),
            mean=place.mean,
            covariance=place.covariance,
            effective_sample_size=0.0,
            age_steps=0,
        )
        for index, place in enumerate(pool.places)
    )
