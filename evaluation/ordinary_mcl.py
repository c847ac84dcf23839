"""Ordinary MCL from the same pieces, to compare with: one cloud, no clusters kept apart.

It starts with as many particles as a search, shrinks to as many as all clusters have together,
and is never restarted. Its places are read off the cloud each step, as nav2 does. Its variants
have what Cluster-MCL and AMCL have beside it: visibility, random particles, and KLD-sampling.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import msgspec
import numpy as np

from coordinator.belief.outcome import Outcome
from evaluation.recovery import Recovery, RecoveryGains
from evaluation.visible_field_model import VisibleFieldModel
from particle_filter import global_search
from particle_filter.arrays import FREE, Poses
from particle_filter.cluster_filter import Cloud
from particle_filter.kld_sampling import sufficient_particles
from particle_filter.likelihood_field_model import LikelihoodFieldModel
from particle_filter.random_streams import Purpose, generator
from particle_filter.resampling import resample
from particle_filter.sensor_model import SensorModel
from particle_filter.settings import FilterSettings
from protocol.answers import Hypothesis
from protocol.pose_arrays import covariance_tuple, pose_tuple
from protocol.steps import Scan
from worker.scan_beams import scan_beams

KLD_ERROR, KLD_LEAST_PARTICLES = 0.05, 500
"""As nav2's `pf_err` and `min_particles`; the most are as many as without."""
RAYS_PER_POSE = 6
"""Each of the many thousand poses follows so many beams for all of them, its neighbours others: a
pose's weight errs by 0.2 nat, and a step takes a third of the time that half the beams take."""


@dataclass(frozen=True, kw_only=True)
class Variant:
    """What is added to ordinary MCL."""

    visibility: bool = False
    """Hidden ends of beams count against poses, see `VisibleFieldModel`; not in a beam model,
    which follows all rays anyway."""
    recovery: RecoveryGains | None = None
    """Random particles while scans fit worse than they used to."""
    kld: bool = False
    """As many particles as the spread of the cloud asks for, once the first search has ended."""


PLAIN = Variant()


def outcomes(
    scans: Iterable[Scan],
    model: SensorModel,
    settings: FilterSettings,
    variant: Variant = PLAIN,
) -> Iterator[tuple[Scan, Outcome]]:
    """The belief after every step; arguments as for Cluster-MCL in one process."""
    settings = _plain(settings)
    if variant.visibility:
        model = _with_visibility(model, settings)
    grid = model.grid
    free_area_m2 = float(np.count_nonzero(grid.cells == FREE)) * grid.cell_m**2
    count = global_search.start_particles(free_area_m2, settings.search)
    search: global_search.GlobalSearch | None = None
    recovery = Recovery(variant.recovery) if variant.recovery else None
    before = None
    for scan in scans:
        rng = generator(settings.seed, purpose=Purpose.SEARCH, entity=0, step=scan.step)
        if search is None:
            search = global_search.GlobalSearch(model, settings, _anywhere(model, count, rng))
        else:
            random_share = recovery.random_share if recovery else 0.0
            kld = variant.kld and search.annealed
            search.cloud = redrawn(search.cloud, random_share, model, settings, rng, kld=kld)
        after = np.array(scan.odom_from_robot)
        result = search.advance(before, after, scan_beams(scan, model), rng)
        before = after
        if recovery:
            log_count = math.log(len(result.cloud.log_weights))
            recovery.on_likelihood(result.log_weight_sum - log_count)
        yield scan, _outcome(scan, search.places(rng), settings)


def _anywhere(model: SensorModel, count: int, rng: np.random.Generator) -> Poses:
    """(count, 3) poses spread evenly over the free space."""
    grid = model.grid
    return global_search.uniform_over_free_space(
        grid.cells, grid.cell_m, grid.map_from_grid, count, 0, 1, rng
    )


def _with_visibility(model: SensorModel, settings: FilterSettings) -> SensorModel:
    """The model that looks for hidden ends, where that is not turned off."""
    if not isinstance(model, LikelihoodFieldModel) or model.settings.visibility_particles == 0:
        return model
    sensor = msgspec.structs.replace(
        model.settings, visibility_beam_stride=max(model.settings.max_beams // RAYS_PER_POSE, 1)
    )
    most = settings.search.particles
    return VisibleFieldModel(model.grid, model.field, model.jumps, sensor, most)


def redrawn(
    cloud: Cloud,
    random_share: float,
    model: SensorModel,
    settings: FilterSettings,
    rng: np.random.Generator,
    *,
    kld: bool,
) -> Cloud:
    """The cloud drawn anew with random particles, or with as many as are needed.

    Where neither is asked for it is left as it is: `GlobalSearch` draws by itself.
    """
    count = len(cloud.log_weights)
    crowded = cloud.effective_sample_size < settings.search.resample_below_ess * count
    if random_share == 0.0 and not (kld and crowded):
        return cloud
    if kld:
        most = settings.search.particles
        poses = cloud.map_from_robot
        count = sufficient_particles(poses, KLD_ERROR, min(KLD_LEAST_PARTICLES, most), most)
    chosen = resample(cloud.log_weights, count, settings.cluster.resampling, rng)
    poses = cloud.map_from_robot[chosen]
    random = np.flatnonzero(rng.random(count) < random_share)
    if len(random):
        poses[random] = _anywhere(model, len(random), rng)
    return Cloud.even(poses)


_CLUSTERS = 10
"""Ordinary MCL has as many particles as so many clusters together."""


def _plain(settings: FilterSettings) -> FilterSettings:
    """No annealing, no jitter: just the filter of the textbooks."""
    search = msgspec.structs.replace(
        settings.search,
        shards=1,
        annealing_start_fraction=1.0,
        jitter_m=0.0,
        jitter_rad=0.0,
        particles=_CLUSTERS * settings.cluster.particles,
    )
    return msgspec.structs.replace(settings, search=search)


def _outcome(
    scan: Scan, places: list[global_search.FoundPlace], settings: FilterSettings
) -> Outcome:
    hypotheses = tuple(
        Hypothesis(
            cluster=index,
            probability=place.share,
            log_probability=float(np.log(place.share)),
            mean=pose_tuple(place.mean),
            covariance=covariance_tuple(place.covariance),
            effective_sample_size=0.0,
            age_steps=0,
        )
        for index, place in enumerate(places)
    )
    sure = bool(places) and places[0].share >= settings.belief.localized_probability
    return Outcome(
        step=scan.step,
        state="localized" if sure else "ambiguous" if places else "searching",
        hypotheses=hypotheses,
        elsewhere_probability=0.0,
        searching=False,
        missing=(),
        begin={},
        events=(),
    )
