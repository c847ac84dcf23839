"""The decoy: a mirrored robot, whose fit is that of a wrong place (docs/belief.md)."""

import math
from collections.abc import Mapping, Sequence
from typing import Annotated

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from clustermcl.belief.cluster_set import Cluster, ClusterSet
from clustermcl.belief.explained import NO_PLACE, explains
from clustermcl.belief.part import FEW, Part
from clustermcl.belief.search_course import SearchCourse
from clustermcl.protocol.job_events import Ended
from clustermcl.protocol.work import Job, Report, TrackJob, TrackReport

DECOYS = 3
"""Tracked places of the mirrored robot."""
SCANS = 4
"""Scans that a search for a decoy uses."""
PATIENCE = 10
"""Steps from the end of a search for a decoy to the next one."""
LEAST_REST = 1e-6
"""Least probability of the places of such a search that are not tracked."""


class Decoy(Part):
    """Searches for a mirrored robot and tracks it (docs/belief.md).

    A mirrored robot is not on the map, so its fit is the fit of a wrong place. The ensemble needs
    it only while it is uncertain whether the robot is on the map.
    """

    search: SearchCourse
    places: Annotated[tuple[Cluster, ...], FEW] = ()

    @property
    def track_ids(self) -> tuple[str, ...]:
        return tuple(place.job_id for place in self.places)

    def explains(
        self, reports: Mapping[str, TrackReport], beams: NDArray[np.float64], held: ClusterSet
    ) -> float | None:
        """Return the log evidence of a scan's new beams at the decoys; None: none has reported.

        It is averaged over all places of the decoy's search, of which those not tracked explain
        `NO_PLACE` of them. One that explains more counts more from then on.
        """
        unit, sharpness = held.piece_evidence, held.sharpness
        found = [(place, reports.get(place.job_id)) for place in self.places]
        told = [
            (place, r, each) for place, r in found if r and (each := explains(r, beams, sharpness))
        ]
        if not told:
            return None
        rest = max(1.0 - math.fsum(place.probability for place, _, _ in told), LEAST_REST)
        of_rest = math.log(rest) + unit * NO_PLACE * float(beams.sum())
        weighed = np.array(
            [*(place.log_probability + unit * each.clear for place, _, each in told), of_rest]
        )
        mean = float(np.logaddexp.reduce(weighed))
        moved = {
            place.cluster: replace(place, pose=r.pose, covariance=r.covariance, log_probability=log)
            for (place, r, _), log in zip(told, (weighed[:-1] - mean).tolist(), strict=True)
        }
        self.places = tuple(moved.get(place.cluster, place) for place in self.places)
        return mean

    def follow(
        self, step: int, reports: Sequence[Report], *, is_open: bool
    ) -> tuple[dict[str, Job], list[Ended]]:
        """Begin and end the decoy's jobs after a step, and return them.

        `is_open`: it is uncertain whether the robot is on the map.
        """
        begin: dict[str, Job] = {}
        ended: list[Ended] = []
        pool = self.search.on_reports(reports, ())
        if pool is not None and pool.step - self.search.pool.first_step + 1 >= SCANS:
            ended += self._end_tracking() + self.search.stop(step, "search over")
            first = (self.search.begun - 1) * DECOYS
            for index in range(min(len(pool.share), DECOYS)):
                found, number = pool.place(index, pool.share[index]), first + index
                place = Cluster(
                    number, math.log(found.share), step, found.pose, found.covariance, mirrored=True
                )
                self.places += (place,)
                begin[place.job_id] = TrackJob(
                    cluster=number, start=found.sample, exact=False, mirrored=True
                )
        if not self.search.runs and self.search.is_due(step, PATIENCE):
            if is_open:
                begin |= self.search.begin(step + 1)
            else:
                ended += self._end_tracking()
        return begin, ended

    def stop(self, step: int) -> list[Ended]:
        return self._end_tracking() + self.search.stop(step, "search stopped")

    def _end_tracking(self) -> list[Ended]:
        ended = [Ended(job_id, "search stopped") for job_id in self.track_ids]
        self.places = ()
        return ended
