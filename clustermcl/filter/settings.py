"""The settings of the filter: one frozen structure for each part, with units and meanings.

Every work order contains them, so all workers of a robot use the same. The defaults are the same
for all buildings and recordings. `clustermcl settings` prints the text below each setting.
"""

from functools import lru_cache
from typing import Annotated, Literal, TypeAlias, TypeVar

import msgspec
from msgspec import Meta

NotNegative: TypeAlias = Annotated[float, Meta(ge=0)]
Positive: TypeAlias = Annotated[float, Meta(gt=0)]
Share: TypeAlias = Annotated[float, Meta(ge=0, le=1)]
NotNegativeInt: TypeAlias = Annotated[int, Meta(ge=0)]
PositiveInt: TypeAlias = Annotated[int, Meta(gt=0)]


class MotionSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Noise of odometry (Probabilistic Robotics, table 5.6 and its omnidirectional twin)."""

    model: Literal["omnidirectional", "differential"] = "omnidirectional"
    """Motion model."""
    turn_noise_per_turn: NotNegative = 0.2
    """Noise of a turn caused by turning (root of nav2's alpha1) [rad/rad]."""
    turn_noise_per_metre: NotNegative = 0.1
    """Noise of a turn caused by driving (root of nav2's alpha2) [rad/m]."""
    drive_noise_per_metre: NotNegative = 0.15
    """Noise along the drive caused by driving (root of nav2's alpha3) [m/m]."""
    drive_noise_per_turn: NotNegative = 0.05
    """Noise along the drive caused by turning (root of nav2's alpha4) [m/rad]."""
    strafe_noise_per_metre: NotNegative = 0.1
    """Noise across the drive, omnidirectional only (root of nav2's alpha5) [m/m]."""


class SensorSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of the sensor model."""

    scan_likelihood_exponent: Positive = 0.1
    """Multiplies the log-likelihood of a scan of max_beams; their errors correlate."""
    max_beams: Annotated[int, Meta(gt=0, le=65_536)] = 60
    """Valid beams used of one scan, spread evenly."""
    max_range_m: Positive = 30.0
    """Beams of this range or longer count as no return [m]."""
    hit_sigma_m: Positive = 0.15
    """Spread of a hit around an obstacle [m]."""
    hit_weight: Annotated[float, Meta(gt=0, le=1)] = 0.75
    """Share of beams that hit the map."""
    random_weight: Annotated[float, Meta(gt=0, le=1)] = 0.25
    """Share of random beams."""
    max_obstacle_distance_m: Positive = 2.0
    """Larger distances to an obstacle count as this one [m]."""
    not_free_log_penalty: Annotated[float, Meta(le=0)] = -1.0
    """Log-weight of a particle on occupied or unknown ground, in each scan."""


class ClusterSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One cluster and its particles (section 2 of the paper)."""

    particles: Annotated[int, Meta(gt=0, le=1_000_000)] = 2000
    """Particles of one tracked cluster, at most."""
    view_distance_m: NotNegative = 0.2
    """Distance after which a scan is new information about the pose, and about a kidnapping;
    0: always [m]."""
    view_turn_rad: Positive = 0.4
    """Turn after which it is [rad]."""
    resample_below_ess: Annotated[float, Meta(gt=0, le=1)] = 0.9
    """Resample if effective sample size / particles is below this."""
    min_particles: Annotated[int, Meta(gt=0, le=1_000_000)] = 500
    """Particles of one tracked cluster, at least."""


class SearchSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Global MCL: the bootstrap and the periodic restart (section 4 of the paper)."""

    heading_step_rad: Annotated[float, Meta(gt=0, le=0.5)] = 0.035
    """Distance between headings in the search of the first scan [rad]."""
    margin: Positive = 12.0
    """Poses worse than the best by more than this are left out [nat]."""
    poses: Annotated[int, Meta(gt=0, le=50_000_000)] = 100_000
    """Poses kept after the first scan, over all shards."""
    shards: Annotated[int, Meta(gt=0, le=64)] = 4
    """Independent parts of a search, whatever the number of workers."""
    max_steps: PositiveInt = 60
    """Length of a search, at most; four times as much while it has more places than clusters can
    track [steps]."""
    converged_mass: Annotated[float, Meta(gt=0, le=1)] = 0.98
    """A search ends when its best places hold this share."""
    source_radius_m: Positive = 1.0
    """Points of a cluster are within this distance of its source point, and clusters whose means
    are so near merge [m]."""
    source_heading_rad: Positive = 0.5
    """And within this difference in heading [rad]."""
    hand_over_particles: Annotated[int, Meta(gt=0, le=100_000)] = 150
    """Particles of a place in a shard's report, if it may become a cluster."""
    places: Annotated[int, Meta(gt=0, le=10_000)] = 256
    """Places in a shard's report, at most."""

    @property
    def reach(self) -> tuple[float, float]:
        """How far two poses of one place are apart at most [m], [rad]."""
        return self.source_radius_m, self.source_heading_rad


class BeliefSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The Bayes filter over clusters (eq. 12-17 and section 4 of the paper)."""

    max_clusters: Annotated[int, Meta(gt=0, le=1_000)] = 64
    """Clusters kept at most."""
    particles: Annotated[int, Meta(ge=0, le=50_000_000)] = 20_000
    """Particles of all clusters, shared out by probability as it changes; 0: cluster.particles
    each."""
    least_probability: Share = 0.0001
    """Places below this probability are not reported by searches and do not enter, clusters below
    it are dropped; 0: none."""
    piece_evidence: NotNegative = 0.7
    """Least evidence of a piece of wall that fits, against elsewhere and off the map; 0: whole
    scans [nat]."""
    kidnapping_probability: Annotated[float, Meta(ge=0, lt=1)] = 0.001
    """Probability of a kidnapping at each step; 0: never."""
    off_map_probability: Annotated[float, Meta(ge=0, lt=1)] = 0.05
    """Prior probability that the robot is not on the map, also after a kidnapping; 0: never."""
    elsewhere_poses: Annotated[int, Meta(gt=0, le=1_000_000)] = 2048
    """Poses all over the map at which a scan is weighed."""
    link_probability: Annotated[float, Meta(ge=0, lt=1)] = 0.02
    """Probability, near a lift or another link of a building, of another floor with the next view;
    0: never."""
    lost_probability: Annotated[float, Meta(gt=0, le=1)] = 0.5
    """State `lost` above this probability of elsewhere, off the map included."""
    candidate_probability: Annotated[float, Meta(ge=0, le=0.5)] = 0.003
    """Least weight of a search's places, relative to the belief, at its end."""
    search_every_steps: PositiveInt = 150
    """Interval from one global search to the next [steps]."""
    localized_probability: Annotated[float, Meta(gt=0, le=1)] = 0.9
    """State `localized` from this probability of the best place on."""
    set_pose_probability: Annotated[float, Meta(gt=0, lt=1)] = 0.95
    """Probability of a pose that a user sets."""


class FilterSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """All settings of the filter."""

    seed: NotNegativeInt = 0
    """Seed of all random numbers."""
    motion: MotionSettings = MotionSettings()
    sensor: SensorSettings = SensorSettings()
    cluster: ClusterSettings = ClusterSettings()
    search: SearchSettings = SearchSettings()
    belief: BeliefSettings = BeliefSettings()


SectionT = TypeVar("SectionT", bound=msgspec.Struct)


def section_with(section: SectionT, live: msgspec.Struct) -> SectionT:
    """Return a section, changed by the live values of the same names that are not None."""
    values = {name: getattr(live, name, None) for name in section.__struct_fields__}
    changed = {name: value for name, value in values.items() if value is not None}
    return msgspec.structs.replace(section, **changed)


@lru_cache(maxsize=8)
def filter_with(settings: FilterSettings, live: msgspec.Struct) -> FilterSettings:
    """Return the filter's settings, with motion and sensor changed as by `section_with`."""
    motion, sensor = section_with(settings.motion, live), section_with(settings.sensor, live)
    return msgspec.structs.replace(settings, motion=motion, sensor=sensor)
