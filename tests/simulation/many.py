"""Many schedules, on all cores: each is a world of its own."""

import traceback
from collections.abc import Iterable, Iterator
from functools import cache
from multiprocessing import get_context
from multiprocessing.pool import Pool

from clustermcl.filter.laser.sensor_model import SensorModel
from tests.simulation.laws import LawBrokenError
from tests.simulation.simulation import Simulation
from tests.unit.coordinator.living import symmetric_room


def processes(count: int | None = None) -> Pool:
    """Processes that run schedules; None: one a core."""
    return get_context("spawn").Pool(count)


def broken(pool: Pool, seeds: Iterable[int]) -> Iterator[str]:
    """What went wrong, of each of these schedules in which anything did, as soon as it has."""
    return filter(None, pool.imap_unordered(_problem, seeds, chunksize=4))


def _problem(seed: int) -> str:
    try:
        Simulation(seed, _model()).run()
    except LawBrokenError as error:
        return str(error)
    except Exception:  # noqa: BLE001 - whatever it is, it is told with its seed
        return traceback.format_exc()
    return ""


@cache
def _model() -> SensorModel:
    return symmetric_room()
