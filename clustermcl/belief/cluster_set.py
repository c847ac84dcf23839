"""The tracked places, and the probabilities of these, elsewhere on this map, and off the map."""

import math
import sys
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Annotated, Any, ClassVar, TypeAlias

import msgspec
import numpy as np
from msgspec import Meta
from msgspec.structs import replace
from numpy.typing import NDArray

from clustermcl.belief import log_probabilities as belief
from clustermcl.belief.dead_reckoning import moved_by
from clustermcl.belief.familiarity import USUAL, Familiarity, Learned
from clustermcl.belief.overlaps import merge_overlapping
from clustermcl.belief.part import FEW, Count, LogProbability, Part
from clustermcl.filter.arrays import Pose
from clustermcl.filter.cluster.gaussian import share_near_mean
from clustermcl.filter.laser.evidence_model import LARGE_FALL, UsualFit, through_beam_loss
from clustermcl.filter.motion.noise import motion_covariance
from clustermcl.filter.settings import BeliefSettings, FilterSettings
from clustermcl.protocol.job_events import Began, BeganCause, Ended, EndedCause, JobEvent
from clustermcl.protocol.message import Covariance, NotNegative, Number, NumberOrNone, PoseTuple
from clustermcl.protocol.work import ParticleCount, Place, TrackReport

ESTABLISHED = 15.0
"""New scans after which a given place that holds is right: beams that then pass through walls show
what has changed in the building."""
LIFTED = 16.0
"""Shortfall of the fit above which a robot whose place a person gave was probably lifted. It is
larger than `LARGE_FALL` because the fit also falls, scan by scan, where the building has changed
[nat]."""
LEAST_LOG = -1e6
"""Least log probability: it stays finite, so that evidence can raise it again."""


class Cluster(msgspec.Struct, frozen=True):
    """One tracked place."""

    cluster: Number
    log_probability: Annotated[float, Meta(ge=-sys.float_info.max, le=1e-6)]
    born_step: NumberOrNone
    pose: PoseTuple
    covariance: Covariance
    effective_sample_size: NotNegative = 0.0
    particles: ParticleCount | None = None
    """Particles that track it from `particles_from` on; None: not decided."""
    particles_from: NumberOrNone = -1
    """First step that may resample to `particles`; -1: since it began."""
    confirmed: bool = True
    """Whether a scan was weighed there; a pose that was given waits for one."""
    familiarity: Familiarity = Familiarity()
    """How well the map explains what was seen since it began."""
    mirrored: bool = False
    """A decoy: the mirrored scans are tracked here."""

    @property
    def job_id(self) -> str:
        return f"{'d' if self.mirrored else 'c'}{self.cluster}"

    @property
    def probability(self) -> float:
        return math.exp(self.log_probability)


class Given(msgspec.Struct, frozen=True):
    """How a place that a person gave holds: a one-sided CUSUM test of its new beams."""

    scans: NotNegative = 0.0
    """Scans since then, each by how new it is."""
    doubt: NotNegative = 0.0
    """Evidence of new beams against it [nat]."""
    searched: bool = False
    """Whether a search has found nothing better: it is not doubted again, and if it still holds
    when it is established, nothing is tracked beside it."""

    def after(self, against: float, news: float) -> "Given":
        """Return the test after a scan.

        Args:
            against: evidence of its new beams against the place [nat].
            news: share of the scan that is new.
        """
        is_tested = not (self.searched or self.is_established)
        doubt = max(self.doubt + against, 0.0) if is_tested else 0.0
        return Given(self.scans + news, doubt, self.searched)

    @property
    def is_doubted(self) -> bool:
        return self.doubt > LARGE_FALL

    @property
    def is_established(self) -> bool:
        return self.scans >= ESTABLISHED


Candidate: TypeAlias = tuple[Place, BeganCause]
"""A place that may become a cluster, and its origin. The share of the place is its weight relative
to the belief, which sums to one before the place enters."""


class ClusterSet(Part):
    """All clusters of one robot, in the order of their numbers."""

    local: ClassVar = frozenset({"settings"})
    settings: FilterSettings = FilterSettings()
    clusters: Annotated[dict[Number, Cluster], FEW] = {}
    """By number, in the order in which they are summed."""
    next_cluster: Count = 0
    short: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.2
    """Share of the beams that end before any obstacle, learned during the run."""
    learned: Learned = Learned()
    fit: UsualFit = UsualFit()
    """How well scans fit where the robot is."""
    given: Given | None = None
    """The only place was given, and holds."""
    on_map: bool = False
    """A person gave a place, so the robot is on the map; until all places are forgotten."""
    log_elsewhere: LogProbability = math.nan
    """Of elsewhere on this map; in settings and answers, elsewhere includes off the map."""
    log_off_map: LogProbability = math.nan

    def __post_init__(self) -> None:
        if math.isnan(self.log_elsewhere):  # a new set
            self._is_anywhere()

    def __len__(self) -> int:
        return len(self.clusters)

    @property
    def rules(self) -> BeliefSettings:
        return self.settings.belief

    @property
    def elsewhere(self) -> float:
        return math.exp(self.log_elsewhere)

    @property
    def off_map(self) -> float:
        return math.exp(self.log_off_map)

    @property
    def outside_clusters(self) -> float:
        """The probability that the robot is at no tracked place: on this map or off it."""
        return self.elsewhere + self.off_map

    @property
    def is_elsewhere(self) -> bool:
        """Whether the robot is lost, and a search would find it."""
        return self.elsewhere > self.rules.lost_probability

    @property
    def is_lost(self) -> bool:
        """Whether it is at no tracked place: almost surely, where only a given one is tracked."""
        is_first = self.given is not None and not self.given.searched
        most = self.rules.localized_probability if is_first else self.rules.lost_probability
        return self.outside_clusters > most

    @property
    def fit_has_fallen(self) -> bool:
        """Whether scans fit so much worse than usual that the robot was probably lifted."""
        return self.fit.shortfall > LIFTED if self.on_map else self.fit.has_fallen

    @property
    def piece_evidence(self) -> float:
        """Evidence of a piece of wall that fits, against one that does not [nat]."""
        least = self.rules.piece_evidence
        return max(least, self.learned.probable.evidence) if least else 0.0

    @property
    def changed(self) -> float:
        """How much the building has changed, 0 to 1."""
        return self.learned.changed(self.piece_evidence)

    @property
    def sharpness(self) -> float:
        """How sharply beams fit (`explains`) [nat]."""
        return (1.0 - self.changed) * through_beam_loss(self.settings.sensor)

    @property
    def best(self) -> Cluster:
        """The place that explains most of what it has seen, however improbable."""
        return max(self.clusters.values(), key=lambda cluster: cluster.familiarity.share)

    @property
    def oldest_holds(self) -> bool:
        """Whether the robot is at the oldest place more likely than not."""
        oldest = next(iter(self.clusters.values()), None)
        return oldest is not None and oldest.probability > self.rules.lost_probability

    def all(self) -> tuple[Cluster, ...]:
        """Return the clusters in the order in which they are summed."""
        return tuple(self.clusters.values())

    @property
    def job_ids(self) -> tuple[str, ...]:
        return tuple(cluster.job_id for cluster in self.clusters.values())

    def change(self, cluster: Cluster, **fields: Any) -> None:
        """Replace fields of a cluster."""
        self.clusters[cluster.cluster] = replace(cluster, **fields)

    def by_probability(self) -> list[Cluster]:
        """Return the clusters, most probable first."""
        return sorted(self.clusters.values(), key=lambda c: (-c.log_probability, c.cluster))

    def near(self) -> belief.LogProbabilities:
        """Return `log_probabilities`, but of being within the reach of a search of each pose.

        Elsewhere has what the clouds have beyond it. In the paper a place has no bound.
        """
        is_paper = self.rules.kidnapping_probability == 0.0
        reach = (math.inf, math.inf) if is_paper else self.settings.search.reach
        shares = [share_near_mean(cluster.covariance, *reach) for cluster in self.all()]
        each = list(zip(self.all(), shares, strict=True))
        beyond = (cluster.probability * (1.0 - share) for cluster, share in each)
        logs = [max(cluster.log_probability + log_of(share), LEAST_LOG) for cluster, share in each]
        return np.array([*logs, log_of(math.fsum([self.elsewhere, *beyond])), self.log_off_map])

    def follow(self, reports: Mapping[str, TrackReport]) -> None:
        """Move clusters to the poses of their reports; these confirm a given pose."""
        for cluster in self.all():
            if report := reports.get(cluster.job_id):
                self.change(
                    cluster,
                    pose=report.pose,
                    covariance=report.covariance,
                    effective_sample_size=report.effective_sample_size,
                    confirmed=True,
                )

    def carry(self, job_ids: Collection[str], before_from_after: Pose) -> None:
        """Move clusters without a report by odometry, whose noise widens them.

        Args:
            job_ids: ids of the jobs that track these clusters.
            before_from_after: (3,) motion of the robot since the step before.
        """
        noise = motion_covariance(before_from_after, self.settings.motion)
        for cluster in self.all():
            if cluster.job_id in job_ids:
                moved = moved_by(cluster.pose, cluster.covariance, before_from_after, noise)
                self.change(cluster, pose=moved[0], covariance=moved[1])

    def merge_overlaps(self) -> list[Ended]:
        """Join clusters in reach of each other: probabilities add, the most probable one stays."""
        ordered = self.by_probability()
        if len(ordered) < 2:
            return []
        ended = list[Ended]()
        means = np.array([cluster.pose for cluster in ordered])
        into = merge_overlapping(means, *self.settings.search.reach)
        for index in np.unique(into):
            first, *rest = [ordered[member] for member in np.flatnonzero(into == index)]
            total = np.logaddexp.reduce([c.log_probability for c in (first, *rest)])
            self.change(first, log_probability=float(total))
            ended += self.end(rest, "merged", first)
        return ended

    def admit(
        self, candidates: Sequence[Candidate], step: int
    ) -> tuple[list[Cluster], list[JobEvent]]:
        """Add candidates; if there are too many clusters, end the least probable ones.

        Args:
            candidates: with weights relative to the belief; all are normalised afterwards.
            step: the step after which they are tracked.

        Returns:
            The new clusters, in the order of the candidates, and who began and who ended.
        """
        surplus = max(len(self.clusters) + len(candidates) - self.rules.max_clusters, 0)
        leaving, first = self.by_probability()[::-1][:surplus], self.next_cluster
        for place, cause in candidates:
            self.clusters[self.next_cluster] = Cluster(
                self.next_cluster,
                max(log_of(place.share), LEAST_LOG),
                step,
                place.pose,
                place.covariance,
                confirmed=cause != "given",
                familiarity=Familiarity.of(max(USUAL, self.learned.probable.share)),
            )
            self.next_cluster += 1
        pushing = [self.clusters[number] for number in range(first, self.next_cluster)][-surplus:]
        events: list[JobEvent] = []
        for index, cluster in enumerate(leaving):
            by = pushing[index : index + 1] or pushing[-1:]  # the last one replaces the rest
            events += self.end([cluster], "pushed out", *by)
        self._normalise()
        admitted = [self.clusters[number] for number in range(first, self.next_cluster)]
        events += [
            Began(cluster.job_id, cause, cluster.probability)
            for cluster, (_, cause) in zip(admitted, candidates, strict=True)
        ]
        return admitted, events

    def room(self) -> list[float]:
        """Return the probabilities of the clusters that candidates may replace, in ascending order.

        Free places come first, as clusters of probability 0.
        """
        free = self.rules.max_clusters - len(self.clusters)
        return [0.0] * free + [c.probability for c in reversed(self.by_probability())]

    def drop_improbable(self) -> list[Ended]:
        """End clusters below the least probability, and all beside a given place that holds.

        Elsewhere gets their probability.
        """
        is_held = self.given is not None and self.given.is_established and self.oldest_holds
        least = 1.0 if is_held else self.rules.least_probability
        leaving = [each for each in self.by_probability()[1:] if each.probability < least]
        logs = [cluster.log_probability for cluster in leaving]
        self.log_elsewhere = float(np.logaddexp.reduce([self.log_elsewhere, *logs]))
        ended = self.end(leaving, "improbable")
        self._normalise()
        return ended

    def expect_given(self) -> None:
        """Prepare an empty set for a given place."""
        self.given, self.on_map = Given(), True
        self.log_elsewhere, self.log_off_map = 0.0, -math.inf

    def move(self, gains: Mapping[int, float]) -> None:
        """Add to the probabilities of clusters; negative: take from them."""
        for number, gain in gains.items():
            cluster = self.clusters[number]
            moved = log_of(max(cluster.probability + gain, 0.0))
            self.change(cluster, log_probability=max(moved, LEAST_LOG))

    def take_from_elsewhere(self, share: float) -> None:
        """Reduce elsewhere by a share, which a search has assigned to candidates or clusters."""
        rest = math.log1p(-share) if share < 1.0 else LEAST_LOG
        self.log_elsewhere += rest

    def _is_anywhere(self) -> None:
        """Give all probability to elsewhere on this map and off the map."""
        is_ever_lost = self.rules.kidnapping_probability > 0.0
        off = self.rules.off_map_probability if is_ever_lost else 0.0
        self.log_elsewhere, self.log_off_map = log_of(1.0 - off), log_of(off)

    def clear(self, cause: EndedCause) -> list[Ended]:
        """End all clusters; the robot may be anywhere."""
        self._is_anywhere()
        self.fit, self.given, self.on_map = UsualFit(), None, False
        return self.end(self.all(), cause)

    def end(self, leaving: Iterable[Cluster], cause: EndedCause, *by: Cluster) -> list[Ended]:
        """Remove clusters, whose probability nothing else gets yet; return their events."""
        for cluster in leaving:
            del self.clusters[cluster.cluster]
        others = tuple(other.job_id for other in by)
        return [Ended(cluster.job_id, cause, others, cluster.probability) for cluster in leaving]

    def log_probabilities(self) -> belief.LogProbabilities:
        """Return (K + 2,) log probabilities of the clusters, of elsewhere, and of off the map."""
        clusters = (cluster.log_probability for cluster in self.all())
        return np.array([*clusters, self.log_elsewhere, self.log_off_map])

    def _normalise(self) -> None:
        if self.clusters and self.rules.kidnapping_probability == 0.0:
            self.log_elsewhere = self.log_off_map = -math.inf
        self.set_log_probabilities(belief.normalised_logs(self.log_probabilities()))

    def set_log_probabilities(self, log_probabilities: NDArray[np.float64]) -> None:
        *clusters, self.log_elsewhere, self.log_off_map = log_probabilities.tolist()
        for cluster, value in zip(self.all(), clusters, strict=True):
            self.change(cluster, log_probability=max(value, LEAST_LOG))


def log_of(probability: float) -> float:
    return math.log(probability) if probability > 0.0 else -math.inf
