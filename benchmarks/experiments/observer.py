"""Observes a run: records every step, decides when to kidnap the robot and when to end."""

from benchmarks.experiments.case import AfterStep, Case, OnceRight, SimulatedRobot
from benchmarks.experiments.measures import (
    Counts,
    RunMeasures,
    Update,
    calibration_of,
    measures_of,
    update_of,
)
from benchmarks.experiments.observability import ScanObservability, middle_of, turned_copies
from clustermcl.belief.outcome import Outcome
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import Scan
from clustermcl.recordings.maps.grid_map import GridMap

GOOD_BEFORE_KIDNAP = 40
"""The robot is kidnapped after this number of right estimates in a row."""


class Observer:
    """Receives every step in order.

    Args:
        case: the experiment.
        grid_map: the localizer's map.
    """

    def __init__(self, case: Case, grid_map: GridMap) -> None:
        self._case, self._middle = case, middle_of(grid_map)
        match case.robot:
            case SimulatedRobot(people=people, kidnapping=kidnapping):
                self._people, self._kidnapping = people, kidnapping
            case _:
                self._people, self._kidnapping = 0, None
        self._observability = (
            ScanObservability(grid_map) if case.has_feature or self._people else None
        )
        self._updates: list[Update] = []
        self._update = self._right_in_a_row = 0
        self._seen_at: int | None = None
        self._kidnapped_at: int | None = None
        self._right_before_kidnap: bool | None = None
        self._short_shares: list[float] = []

    def on_step(self, scan: Scan, outcome: Outcome, truth: PoseTuple | None) -> None:
        """Take a step and the resulting belief; `truth` is None if unknown."""
        self._update += 1
        symmetry = self._case.symmetry
        copies = turned_copies(truth, symmetry, self._middle) if truth else ()
        update = update_of(self._update, scan.stamp_ns, outcome, copies)
        self._updates.append(update)
        if truth is not None:
            self._right_in_a_row = self._right_in_a_row + 1 if update.facts.right else 0
            self._look(scan, copies)

    @property
    def kidnap_now(self) -> bool:
        """Whether to kidnap the robot before the next step."""
        if self._kidnapped_at is not None:
            return False
        match self._kidnapping:
            case None:
                return False
            case AfterStep(step=step):
                return self._update == step + 1
            case OnceRight(at_latest=at_latest):
                good = self._right_in_a_row >= GOOD_BEFORE_KIDNAP
                return good or self._update >= at_latest

    def kidnapped(self) -> None:
        self._kidnapped_at = self._update
        self._right_before_kidnap = self._right_in_a_row >= GOOD_BEFORE_KIDNAP

    @property
    def over(self) -> bool:
        """Whether the run has enough updates after its event."""
        event = self._seen_at or self._kidnapped_at
        after = self._case.updates_after_event
        return event is not None and after is not None and self._update >= event + after

    @property
    def calibration(self) -> Counts:
        """See `calibration_of`."""
        return calibration_of(self._updates)

    def measures(self, wall_s: float, cpu_s: float = 0.0) -> RunMeasures:
        shares = self._short_shares
        return measures_of(
            self._updates,
            seen_at_update=self._seen_at,
            kidnapped_at_update=self._kidnapped_at,
            right_before_kidnap=self._right_before_kidnap,
            short_beam_share=sum(shares) / len(shares) if shares else None,
            wall_s=wall_s,
            cpu_s=cpu_s,
        )

    def _look(self, scan: Scan, copies: tuple[PoseTuple, ...]) -> None:
        """Record occlusion, and when the feature is first observable."""
        if self._observability is None:
            return
        if self._people:
            self._short_shares.append(self._observability.short_share(scan, copies[0]))
        if self._case.has_feature and self._seen_at is None:
            self._seen_at = (
                self._update if self._observability.distinguishes(scan, copies) else None
            )
