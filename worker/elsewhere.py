"""How likely a scan is wherever the robot may be: what the tracked places are held against."""

import math

import numpy as np
from msgspec.structs import replace

from particle_filter.cluster_filter import Cloud, weighed
from particle_filter.random_streams import Purpose, generator
from particle_filter.sensor_model import SensorModel
from particle_filter.settings import FilterSettings
from particle_filter.uniform_poses import UniformPoses
from protocol.steps import Scan
from protocol.work import Assignment, ElsewhereJob, ElsewhereReport
from worker.scan_beams import scan_beams


class Elsewhere:
    """Weighs each scan at poses all over the free space, new ones each time."""

    def __init__(
        self,
        assignment: Assignment,
        job: ElsewhereJob,
        model: SensorModel,
        settings: FilterSettings,
        sender: str,
    ) -> None:
        self.assignment, self.step = assignment, job.first_step - 1
        self._sender = sender
        self._model, self._settings = model, settings
        self._poses = UniformPoses(model.grid, self._rng(0, part=1))

    def use(self, model: SensorModel, settings: FilterSettings) -> None:
        """Go on with other numbers."""
        self._model, self._settings = model, settings

    def advance(self, scan: Scan) -> ElsewhereReport:
        """Tell the average likelihood of a scan, just as that of a cluster is told."""
        poses = self._poses.draw(self._settings.belief.elsewhere_poses, self._rng(scan.step))
        beams = scan_beams(scan, self._model)
        exponent = self._settings.sensor.scan_likelihood_exponent
        result = weighed(Cloud.even(poses), beams, self._model, exponent)
        taken_back = self._model.correction(poses, result.cloud.weights, beams)
        self.step = scan.step
        return ElsewhereReport(
            sender=self._sender,
            job_id=self.assignment.job_id,
            epoch=self.assignment.epoch,
            step=scan.step,
            log_likelihood=result.log_weight_sum - math.log(len(poses)) - taken_back,
        )

    def handed_on(self) -> Assignment:
        """The same job, from the next step on."""
        job = ElsewhereJob(first_step=self.step + 1)
        return replace(self.assignment, job=job)

    def _rng(self, step: int, part: int = 0) -> np.random.Generator:
        seed = self._settings.seed
        return generator(seed, purpose=Purpose.ELSEWHERE, entity=0, step=step, part=part)
