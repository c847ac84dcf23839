"""The settings of the filter: one frozen structure for each part, with units and meanings.

Every work order contains them, so all workers of a robot use the same. The defaults are the same
for all buildings and recordings.
"""

from functools import lru_cache
from typing import Annotated, Literal, TypeAlias, TypeVar, get_args

import msgspec
from msgspec import Meta

from particle_filter.extensions import Kind, names

SensorModelName: TypeAlias = Literal["likelihood_field", "beam"]
"""Names of the sensor models that `sensor_models.OWN` has."""
MotionModelName: TypeAlias = Literal["omnidirectional", "differential"]

_NAME, _NUMBER = r"[A-Za-z0-9_-]+", r"-?\d+(\.\d+)?"
_CORNER = rf"{_NUMBER}[ ]+{_NUMBER}"
_REGIONS_FORM = "NAME: X Y, X Y; NAME: X Y, X Y, X Y; ..."
_REGIONS_PATTERN = rf"\A([ ]*{_NAME}:[ ]*{_CORNER}(,[ ]*{_CORNER})+[ ]*(;|\Z))*[ ]*\Z"


def described(meaning: str, unit: str = "", form: str = "", **bounds: float | str) -> Meta:
    """Return bounds, unit and meaning of a setting, for checks and for `clustermcl settings`.

    Args:
        meaning: the meaning in a few words.
        unit: unit of a number.
        form: allowed form of a text, in words.
        **bounds: `gt`, `ge`, `lt`, `le`, `pattern`, `max_length`, as in `msgspec.Meta`.
    """
    return Meta(description=meaning, extra={"unit": unit, "form": form}, **bounds)  # type: ignore[call-overload, no-any-return] # one signature for its four


def _check_model(kind: Kind, name: str, own: tuple[str, ...]) -> None:
    if name not in own and name not in names(kind):
        raise ValueError(f"no {kind} {name!r} is installed")


class MotionSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Noise of odometry (Probabilistic Robotics, table 5.6 and its omnidirectional twin)."""

    model: Annotated[
        str,
        described("motion model", form='"omnidirectional", "differential" or an installed one'),
    ] = "omnidirectional"
    turn_noise_per_turn: Annotated[
        float,
        described("noise of a turn caused by turning (root of nav2's alpha1)", "rad/rad", ge=0),
    ] = 0.2
    turn_noise_per_metre: Annotated[
        float, described("noise of a turn caused by driving (root of nav2's alpha2)", "rad/m", ge=0)
    ] = 0.1
    drive_noise_per_metre: Annotated[
        float,
        described("noise along the drive caused by driving (root of nav2's alpha3)", "m/m", ge=0),
    ] = 0.15
    drive_noise_per_turn: Annotated[
        float,
        described("noise along the drive caused by turning (root of nav2's alpha4)", "m/rad", ge=0),
    ] = 0.05
    strafe_noise_per_metre: Annotated[
        float,
        described(
            "noise across the drive, omnidirectional only (root of nav2's alpha5)", "m/m", ge=0
        ),
    ] = 0.1
    slip_probability: Annotated[
        float,
        described("probability of a slip or a push, where scans fit badly", ge=0, le=0.5),
    ] = 0.05
    slip_below_fit: Annotated[
        float,
        described("slips are tried if the best particle fits worse", "nat/beam"),
    ] = 0.5

    def __post_init__(self) -> None:
        _check_model("motion_model", self.model, get_args(MotionModelName))


class SensorSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of the sensor model."""

    model: Annotated[
        str, described("sensor model", form='"likelihood_field", "beam" or an installed one')
    ] = "likelihood_field"
    scan_likelihood_exponent: Annotated[
        float,
        described(
            "multiplies the log-likelihood of a scan of max_beams; their errors correlate", gt=0
        ),
    ] = 0.1
    max_beams: Annotated[
        int, described("valid beams used of one scan, spread evenly", gt=0, le=65_536)
    ] = 60
    max_range_m: Annotated[
        float, described("beams of this range or longer count as no return", "m", gt=0)
    ] = 30.0
    hit_sigma_m: Annotated[float, described("spread of a hit around an obstacle", "m", gt=0)] = 0.15
    hit_weight: Annotated[float, described("share of beams that hit the map", gt=0, le=1)] = 0.75
    random_weight: Annotated[float, described("share of random beams", gt=0, le=1)] = 0.25
    short_weight: Annotated[
        float,
        described("beam model: share of beams cut short by objects that are not in the map", ge=0),
    ] = 0.1
    max_weight: Annotated[float, described("beam model: share of beams without return", ge=0)] = (
        0.05
    )
    short_decay_per_m: Annotated[
        float, described("beam model: decay of short readings", "1/m", gt=0)
    ] = 0.3
    max_obstacle_distance_m: Annotated[
        float,
        described("likelihood field: larger distances to an obstacle count as this one", "m", gt=0),
    ] = 2.0
    visibility_particles: Annotated[
        int,
        described(
            "particles of a cluster that check beams for occlusion; 0: none", ge=0, le=100_000
        ),
    ] = 50
    visibility_beam_stride: Annotated[
        int, described("each of them checks every n-th beam", gt=0)
    ] = 5
    occlusion_weight: Annotated[
        float, described("share of the score of occluded beams that the evidence loses", ge=0, le=1)
    ] = 0.1
    occlusion_tolerance: Annotated[
        float, described("score of occluded beams that is tolerated", "nat/beam", ge=0)
    ] = 0.1
    not_free_log_penalty: Annotated[
        float,
        described("log-weight of a particle on occupied or unknown ground, at each step", le=0),
    ] = -1.0

    def __post_init__(self) -> None:
        _check_model("sensor_model", self.model, get_args(SensorModelName))


class ClusterSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One cluster and its particles (section 2 of the paper)."""

    particles: Annotated[
        int, described("particles of one tracked cluster, at most", gt=0, le=1_000_000)
    ] = 2000
    view_distance_m: Annotated[
        float,
        described(
            "distance after which a scan is new information about the pose in a cluster; 0: always",
            "m",
            ge=0,
        ),
    ] = 0.2
    view_turn_rad: Annotated[float, described("turn after which it is", "rad", gt=0)] = 0.4
    resample_below_ess: Annotated[
        float,
        described("resample if effective sample size / particles is below this", gt=0, le=1),
    ] = 0.9
    min_particles: Annotated[
        int, described("particles of one tracked cluster, at least", gt=0, le=1_000_000)
    ] = 500
    split_every_steps: Annotated[
        int,
        described("interval at which clusters in several parts are split; 0: never", "steps", ge=0),
    ] = 0
    split_min_share: Annotated[
        float,
        described(
            "share of a cluster's weight that a part needs to become a cluster", gt=0, le=0.5
        ),
    ] = 0.2


class SearchSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Global MCL: the bootstrap and the periodic restart (section 4 of the paper)."""

    heading_step_rad: Annotated[
        float,
        described("distance between headings in the search of the first scan", "rad", gt=0, le=0.5),
    ] = 0.035
    margin: Annotated[
        float, described("poses worse than the best by more than this are left out", "nat", gt=0)
    ] = 12.0
    poses: Annotated[
        int, described("poses kept after the first scan, over all shards", gt=0, le=50_000_000)
    ] = 100_000
    shards: Annotated[
        int, described("independent parts of a search, whatever the number of workers", gt=0, le=64)
    ] = 4
    max_steps: Annotated[
        int,
        described(
            "a search ends at the latest after; with four times as many, where more is possible "
            "than fits into the clusters",
            "steps",
            gt=0,
        ),
    ] = 60
    converged_mass: Annotated[
        float, described("a search ends when its best places hold this share", gt=0, le=1)
    ] = 0.98
    source_radius_m: Annotated[
        float,
        described("points of a cluster are within this distance of its source point", "m", gt=0),
    ] = 1.0
    source_heading_rad: Annotated[
        float, described("and within this difference in heading", "rad", gt=0)
    ] = 0.5
    hand_over_particles: Annotated[
        int, described("particles of a place in a shard's report", gt=0, le=100_000)
    ] = 150
    places: Annotated[int, described("places in a shard's report, at most", gt=0, le=10_000)] = 256
    places_with_particles: Annotated[
        int, described("places of them with particles", gt=0, le=10_000)
    ] = 64
    min_place_share: Annotated[
        float, described("places with a smaller share of the search are not reported", ge=0, le=1)
    ] = 0.0001
    regions: Annotated[
        str,
        described(
            "where `relocalize --region` searches: two corners of a rectangle, or a polygon's",
            "m",
            form=_REGIONS_FORM,
            pattern=_REGIONS_PATTERN,
            max_length=10_000,
        ),
    ] = ""


class BeliefSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The Bayes filter over clusters (eq. 12-17 and section 4 of the paper)."""

    max_clusters: Annotated[int, described("clusters kept at most", gt=0, le=1_000)] = 64
    particles: Annotated[
        int,
        described(
            "particles of all clusters, shared out by probability as it changes; 0: "
            "cluster.particles each",
            ge=0,
            le=50_000_000,
        ),
    ] = 20_000
    least_probability: Annotated[
        float,
        described(
            "places below this probability do not enter, clusters below it are dropped; 0: none",
            ge=0,
            le=1,
        ),
    ] = 0.0001
    transition_probability: Annotated[
        float, described("share of the belief spread over all clusters at each step", ge=0, le=1)
    ] = 0.0001
    view_distance_m: Annotated[
        float,
        described(
            "distance after which a scan is a new view of the building; 0: always", "m", ge=0
        ),
    ] = 0.8
    view_turn_rad: Annotated[float, described("turn after which it is", "rad", gt=0)] = 1.6
    evidence_noise: Annotated[
        float,
        described("Monte Carlo error of the difference in evidence between places", "nat", ge=0),
    ] = 0.3
    evidence_residual: Annotated[
        float,
        described("residual at which differences between places count half", "nat/beam", gt=0),
    ] = 0.25
    kidnapping_probability: Annotated[
        float,
        described("probability of a kidnapping at each step; 0: never", ge=0, lt=1),
    ] = 0.001
    off_map_probability: Annotated[
        float,
        described(
            "prior probability that the robot is not on the map, also after a kidnapping; 0: never",
            ge=0,
            lt=1,
        ),
    ] = 0.05
    elsewhere_poses: Annotated[
        int, described("poses all over the map at which a scan is weighed", gt=0, le=1_000_000)
    ] = 2048
    lost_probability: Annotated[
        float,
        described("state `lost` above this probability of elsewhere and off the map", gt=0, le=1),
    ] = 0.5
    candidate_probability: Annotated[
        float,
        described(
            "least weight of a search's places, relative to the belief, at its end", ge=0, le=0.5
        ),
    ] = 0.003
    minimum_lifetime_steps: Annotated[
        int, described("minimum lifetime of a new cluster", "steps", ge=0)
    ] = 15
    merge_every_steps: Annotated[
        int, described("interval at which overlapping clusters are merged", "steps", gt=0)
    ] = 5
    merge_distance_m: Annotated[
        float, described("clusters merge if their means are within this distance", "m", gt=0)
    ] = 0.5
    merge_heading_rad: Annotated[
        float, described("and within this difference in heading", "rad", gt=0)
    ] = 0.35
    search_every_steps: Annotated[
        int, described("interval from one global search to the next", "steps", gt=0)
    ] = 150
    localized_probability: Annotated[
        float, described("state `localized` from this probability of the best place on", gt=0, le=1)
    ] = 0.9
    set_pose_probability: Annotated[
        float, described("probability of a pose that a user sets", gt=0, le=1)
    ] = 0.95


class FilterSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """All settings of the filter."""

    seed: Annotated[int, described("seed of all random numbers", ge=0)] = 0
    motion: MotionSettings = MotionSettings()
    sensor: SensorSettings = SensorSettings()
    cluster: ClusterSettings = ClusterSettings()
    search: SearchSettings = SearchSettings()
    belief: BeliefSettings = BeliefSettings()


SectionT = TypeVar("SectionT", bound=msgspec.Struct)


def section_with(section: SectionT, live: msgspec.Struct) -> SectionT:
    """Return a section of the settings, changed by live values.

    Args:
        section: the section at the start of the process.
        live: new values of fields with the same name; None: the field stays.
    """
    values = {name: getattr(live, name, None) for name in section.__struct_fields__}
    changed = {name: value for name, value in values.items() if value is not None}
    return msgspec.structs.replace(section, **changed)


@lru_cache(maxsize=8)
def filter_with(settings: FilterSettings, live: msgspec.Struct) -> FilterSettings:
    """Return the filter's settings, with motion and sensor changed as by `section_with`."""
    motion, sensor = section_with(settings.motion, live), section_with(settings.sensor, live)
    return msgspec.structs.replace(settings, motion=motion, sensor=sensor)
