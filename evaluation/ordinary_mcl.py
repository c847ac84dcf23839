"""Ordinary MCL from the same pieces, to compare with: one cloud, no clusters kept apart.

It starts with as many particles as a search, shrinks to as many as all clusters have together,
and is never restarted. Its places are read off the cloud each step, as nav2 does.
"""

from collections.abc import Iterable, Iterator

import msgspec
import numpy as np

from coordinator.belief.outcome import Outcome
from particle_filter import global_search
from particle_filter.arrays import FREE
from particle_filter.random_streams import Purpose, generator
from particle_filter.sensor_model import SensorModel
from particle_filter.settings import FilterSettings
from protocol.answers import Hypothesis
from protocol.pose_arrays import covariance_tuple, pose_tuple
from protocol.steps import Scan
from worker.jobs import scan_beams


def outcomes(
    scans: Iterable[Scan], model: SensorModel, settings: FilterSettings
) -> Iterator[tuple[Scan, Outcome]]:
    """The belief after every step; arguments as for Cluster-MCL in one process."""
    settings = _plain(settings)
    grid = model.grid
    free_area_m2 = float(np.count_nonzero(grid.cells == FREE)) * grid.cell_m**2
    count = global_search.start_particles(free_area_m2, settings.search)
    search: global_search.GlobalSearch | None = None
    before = None
    for scan in scans:
        rng = generator(settings.seed, purpose=Purpose.SEARCH, entity=0, step=scan.step)
        if search is None:
            start = global_search.uniform_over_free_space(
                grid.cells, grid.cell_m, grid.map_from_grid, count, 0, 1, rng
            )
            search = global_search.GlobalSearch(model, settings, start)
        after = np.array(scan.odom_from_robot)
        search.advance(before, after, scan_beams(scan, model), rng)
        before = after
        yield scan, _outcome(scan, search.places(rng), settings)


def _plain(settings: FilterSettings) -> FilterSettings:
    """No annealing, no jitter: just the filter of the textbooks."""
    search = msgspec.structs.replace(
        settings.search,
        shards=1,
        annealing_start_fraction=1.0,
        jitter_m=0.0,
        jitter_rad=0.0,
        particles=settings.belief.clusters * settings.cluster.particles,
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
        searching=False,
        missing=(),
        begin={},
        events=(),
    )
