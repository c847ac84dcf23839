"""Tracks many places of a robot whose place is known, and notes what each makes of every scan."""

import math
from collections.abc import Iterator
from typing import Any

import msgspec
import numpy as np

from benchmarks.evidence_model.records import ELSEWHERE_POSES, NOWHERE, Record
from benchmarks.experiments.case import AfterStep, Case, SimulatedRobot
from benchmarks.experiments.mcl import uniform_over_free_space
from benchmarks.experiments.observability import middle_of, turned_copies
from clustermcl.belief.overlaps import merge_overlapping
from clustermcl.evaluation.measures import pose_error
from clustermcl.evaluation.run import TrueStep, course_of
from clustermcl.filter.arrays import Poses
from clustermcl.filter.cluster import cluster_filter
from clustermcl.filter.cluster.cluster_filter import ParticleSet
from clustermcl.filter.laser.evidence_model import scan_exponent
from clustermcl.filter.laser.sensor_model import Beams, SensorModel
from clustermcl.filter.poses import between, heading_distance
from clustermcl.filter.random_streams import Purpose, generator
from clustermcl.filter.search.global_search import GlobalSearch
from clustermcl.filter.settings import FilterSettings
from clustermcl.filter.slices import finished
from clustermcl.jobs.map_model import sensor_model
from clustermcl.jobs.scan_arrays import scan_beams
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.pose_arrays import pose_tuple
from clustermcl.runtime.folders import kept_folder
from clustermcl.runtime.settings import Settings

MERGE_EVERY = 5
PLANTED_SPREAD = np.array([0.2, 0.2, 0.1])
"""Of the particles put at the truth [m, m, rad]."""


def recorded(
    case: Case, seed: int, start_step: int, steps: int, places: int, settings: Settings
) -> Record:
    """Record one run.

    Args:
        case: the experiment; its truth must be known at the first step.
        seed: of the robot and of the filter.
        start_step: the first step of a recording.
        steps: how many, the first one included.
        places: how many clusters to begin with.
        settings: those of the filter; `cluster.particles` are those of one cluster.
    """
    course = course_of(case, seed, settings.bridge, start_step)
    model = sensor_model(course.map, settings.sensor, kept_folder("maps"))
    middle, symmetry = middle_of(course.map), case.symmetry
    first, truth = next(course.steps)
    assert truth is not None, f"{case.name}: the true pose is unknown at step {start_step}"
    whole = msgspec.structs.replace(settings.search, shards=1)
    settings = msgspec.structs.replace(settings, search=whole)
    run = _Run(model, settings, seed, scan_beams(first, model), truth, places)
    kidnapping = case.robot.kidnapping if isinstance(case.robot, SimulatedRobot) else None
    kidnapped_at = kidnapping.step if isinstance(kidnapping, AfterStep) else -1
    rows: list[dict[str, Any]] = []
    before = np.array(first.odom_from_robot)
    for scan, pose in _at_most(course.steps, steps - 1):
        after = np.array(scan.odom_from_robot)
        beams = scan_beams(scan, model)
        row = run.step(scan.step, before, after, beams)
        copies = turned_copies(pose, symmetry, middle) if pose else ()
        row["copy"] = np.array([_copy_of(mean, copies) for mean in row.pop("mean")], np.int8)
        row["distance_m"] = math.dist(before[:2], after[:2])
        row["turn_rad"] = float(heading_distance(before[2], after[2]))
        row["beams"], row["known"] = np.int16(beams.count), pose is not None
        rows.append(row)
        before = after
        if len(rows) == kidnapped_at and course.simulation is not None:
            course.simulation.kidnap()
    table = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    return Record(
        case.name,
        seed,
        start_step,
        kidnapped_at=kidnapped_at,
        share=run.share,
        first_fit=run.first_fit,
        planted=run.planted,
        **table,
    )


def _at_most(steps: Iterator[TrueStep], count: int) -> Iterator[TrueStep]:
    for _ in range(count):
        step = next(steps, None)
        if step is None:
            return
        yield step


def _copy_of(mean: Poses, copies: tuple[PoseTuple, ...]) -> int:
    errors = (pose_error(pose_tuple(mean), copy) for copy in copies)
    return next((index for index, error in enumerate(errors) if error.right), NOWHERE)


class _Run:
    """All clusters of one run."""

    def __init__(
        self,
        model: SensorModel,
        settings: FilterSettings,
        seed: int,
        beams: Beams,
        truth: PoseTuple,
        places: int,
    ) -> None:
        self._model, self._settings, self._seed = model, settings, seed
        rng = generator(seed, purpose=Purpose.SEARCH, entity=0, step=0)
        search = GlobalSearch(model, settings, shard=0)
        self.first_fit = finished(search.advance(None, np.zeros(3), beams, rng))
        found = finished(search.places(rng))[:places]
        self.share = np.array([place.share for place in found])
        clouds = [ParticleSet.even(place.sample) for place in found]
        right = [pose_error(pose_tuple(c.gaussian()[0]), truth).right for c in clouds]
        self.planted = -1
        if not any(right):
            self.planted = len(clouds) - 1
            self.share[-1] = settings.search.min_place_share
            spread = rng.standard_normal((settings.search.hand_over_particles, 3))
            clouds[-1] = ParticleSet.even(np.array(truth) + spread * PLANTED_SPREAD)
        self._clouds: list[ParticleSet | None] = [
            cluster_filter.regularised_resample(
                c.map_from_robot, c.log_weights, settings.cluster.particles, rng
            )
            for c in clouds
        ]
        self._gathered = np.log(self.share)
        self._steps = 0

    def step(self, step: int, before: Poses, after: Poses, beams: Beams) -> dict[str, Any]:
        """Every cluster moves and weighs; overlapping ones merge now and then."""
        settings, count = self._settings, len(self._clouds)
        motion = between(before, after)
        evidence, fit, ess = (np.full(count, np.nan) for _ in range(3))
        means = np.full((count, 3), np.nan)
        for index, cloud in enumerate(self._clouds):
            if cloud is None:
                continue
            rng = generator(self._seed, purpose=Purpose.TRACK, entity=index, step=step)
            result = cluster_filter.mcl_step(
                cloud, motion, beams, self._model, settings.motion, settings.cluster, rng
            )
            self._clouds[index] = result.particles
            evidence[index] = result.log_weight_sum - math.log(len(cloud.log_weights))
            fit[index] = result.log_likelihood_per_beam
            ess[index] = result.particles.effective_sample_size
            means[index] = result.particles.gaussian()[0]
        self._gathered += np.nan_to_num(evidence)
        self._steps += 1
        into = np.arange(count, dtype=np.int16)
        if self._steps % MERGE_EVERY == 0:
            self._merge(means, into)
        rng = generator(self._seed, purpose=Purpose.SEARCH, entity=1, step=step)
        elsewhere = [of_elsewhere(n, beams, self._model, rng) for n in ELSEWHERE_POSES]
        return {
            "evidence": evidence,
            "fit": fit,
            "ess": ess,
            "mean": means,
            "into": into,
            "elsewhere": np.array([log_mean for log_mean, _ in elsewhere]),
            "elsewhere_fit": np.array([fit for _, fit in elsewhere]),
        }

    def _merge(self, means: Poses, into: np.ndarray) -> None:
        """The one that has gathered most stays."""
        alive = np.array([i for i, cloud in enumerate(self._clouds) if cloud is not None])
        order = alive[np.argsort(-self._gathered[alive], kind="stable")]
        rules = self._settings.belief
        groups = merge_overlapping(means[order], rules.merge_distance_m, rules.merge_heading_rad)
        into[order] = order[groups]
        for index in alive[into[alive] != alive]:
            self._clouds[index] = None


def of_elsewhere(
    count: int, beams: Beams, model: SensorModel, rng: np.random.Generator
) -> tuple[float, float]:
    """Log mean likelihood of uniform poses, weighed as clusters are, and the best fit a beam."""
    poses = uniform_over_free_space(model.grid, count, rng)
    exponent = scan_exponent(beams.count, model.settings)
    found = cluster_filter.measurement_update(ParticleSet.even(poses), beams, model, exponent)
    correction = model.correction(poses, found.particles.weights, beams)
    log_mean = found.log_weight_sum - math.log(len(poses)) - correction
    return log_mean, found.log_likelihood_per_beam
