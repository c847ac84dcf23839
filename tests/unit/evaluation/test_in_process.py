import numpy as np

from evaluation.in_process import InProcess
from particle_filter.sensor_model import SensorModel
from particle_filter.sensor_models import computed_model
from particle_filter.settings import (
    BeliefSettings,
    ClusterSettings,
    FilterSettings,
    SearchSettings,
    SensorSettings,
)
from protocol.arrays import ArrayBlob
from protocol.job_events import Began, Ended
from protocol.work import Particles, Place
from tests.unit.coordinator.reports import NO_SPREAD
from tests.unit.worker.test_job_table import model, scan

__all__ = ["model"]  # the fixture


def place(share: float, *means: tuple[float, float, float]) -> Place:
    """A place whose particles are around one point, or around several."""
    spread = np.random.default_rng(0).normal(0.0, 0.02, (200, 3))
    poses = np.repeat(means, 200 // len(means), axis=0) + spread
    sample = Particles(
        step=0,
        odom_from_robot=scan(0).odom_from_robot,
        map_from_robot=ArrayBlob.of(poses, "float64"),
        log_weights=ArrayBlob.of(np.zeros(200), "float64"),
    )
    return Place(share=share, pose=means[0], covariance=NO_SPREAD, sample=sample)


def test_improbable_parts_of_a_split_begin_and_end_in_one_step(model: SensorModel) -> None:
    settings = FilterSettings(
        cluster=ClusterSettings(particles=200, split_every_steps=1),
        search=SearchSettings(heading_step_rad=0.1, poses=400, shards=1),
        belief=BeliefSettings(least_probability=0.25, kidnapping_probability=0.0),
    )
    blunt = computed_model(model.grid, SensorSettings(scan_likelihood_exponent=1e-6))
    process = InProcess(blunt, settings)
    process.advance(scan(0))
    whole, in_two = place(0.6, (2.0, 3.0, 0.0)), place(0.4, (4.0, 4.0, 1.0), (6.0, 3.0, 0.0))
    given = process.ensemble.continue_from([whole, in_two], 0, "forgotten")
    process.carry_out(given)
    kept, apart = given.begin

    outcome = process.advance(scan(1))

    began = [e.job_id for e in outcome.events if isinstance(e, Began)]
    ended = {e.job_id: e.cause for e in outcome.events if isinstance(e, Ended)}
    assert len(began) == 2, "the log tells of both"
    assert ended == {apart: "split", **dict.fromkeys(began, "improbable")}
    assert (outcome.end, dict(outcome.begin)) == ((apart,), {})
    assert [f"c{h.cluster}" for h in process.advance(scan(2)).hypotheses] == [kept]
