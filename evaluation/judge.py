"""How good a run was: every number of `clustermcl evaluate`, defined here and nowhere else.

A step is *judged* if the true pose at its scan is known. The *estimate* of a step is its most
probable place; while the system is still searching for its first places it claims nothing, and
there is no estimate. A place is *right* within 1 m and 20 degrees of the truth.
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from particle_filter.poses import heading_distance
from protocol.answers import Hypothesis, State
from protocol.message import PoseTuple

RIGHT_WITHIN_M = 1.0
RIGHT_WITHIN_RAD = math.radians(20.0)
CONFIDENT_PROBABILITY = 0.9
LAST_STEPS = 10


@dataclass(frozen=True)
class PoseError:
    """How far a pose is from the truth; neither number is negative."""

    distance_m: float
    heading_rad: float

    @property
    def heading_deg(self) -> float:
        """The angle in degrees."""
        return math.degrees(self.heading_rad)

    @property
    def right(self) -> bool:
        """Whether that is near enough."""
        return self.distance_m <= RIGHT_WITHIN_M and self.heading_rad <= RIGHT_WITHIN_RAD


def pose_error(pose: PoseTuple, truth: PoseTuple) -> PoseError:
    """The distance of two poses, the heading the short way round."""
    return PoseError(math.dist(pose[:2], truth[:2]), float(heading_distance(pose[2], truth[2])))


@dataclass(frozen=True, kw_only=True)
class Accuracy:
    """What a run came to. None: there was nothing to measure it on."""

    steps: int
    """Steps made, judged or not."""
    localized: bool
    """The estimates of the last 10 judged steps (of all, if there were fewer) were right."""
    final_error_m: float | None
    """Of the estimate at the last judged step."""
    final_error_rad: float | None
    localized_at_step: int | None
    """If localized: from this step on all estimates were right."""
    localized_at_s: float | None
    """Time of that step since the first one."""
    confidently_wrong_fraction: float | None
    """Share of the judged steps whose estimate was wrong and had a probability of 0.9 or more."""
    truth_tracked_fraction: float | None
    """Share of the judged steps after the first search on which some place was right."""
    truth_probability_mean: float | None
    """Mean over the same steps of the probability of all right places together."""
    rmse_m: float | None
    """Root mean square distance of the estimates from `localized_at_step` on."""


class Judge:
    """Told of every step in order; of constant size, however long the run."""

    def __init__(self) -> None:
        self._first_stamp_ns: int | None = None
        self._steps = self._judged = self._confidently_wrong = 0
        self._searched = False
        self._after_search = self._tracked = 0
        self._probability = 0.0
        self._last_right: deque[bool] = deque(maxlen=LAST_STEPS)
        self._final: PoseError | None = None
        self._streak = _Streak(0, 0)

    def on_step(
        self,
        step: int,
        stamp_ns: int,
        state: State,
        hypotheses: Sequence[Hypothesis],
        truth: PoseTuple | None,
    ) -> None:
        """Judge one step.

        Args:
            step: its number.
            stamp_ns: time of its scan.
            state: of the system after it.
            hypotheses: the places held after it, most probable first.
            truth: where the robot was; None where nobody knows.
        """
        self._steps += 1
        if self._first_stamp_ns is None:
            self._first_stamp_ns = stamp_ns
        searching = state == "searching"
        self._searched = self._searched or not searching
        if truth is None:
            return
        places = () if searching else hypotheses
        errors = [pose_error(place.mean, truth) for place in places]
        self._judge_estimate(step, stamp_ns, places, errors)
        if self._searched:
            right = [p.probability for p, e in zip(places, errors, strict=True) if e.right]
            self._after_search += 1
            self._tracked += bool(right)
            self._probability += math.fsum(right)

    def accuracy(self) -> Accuracy:
        """What the steps so far came to."""
        localized = bool(self._last_right) and all(self._last_right)
        streak = self._streak if localized else None
        start_ns = self._first_stamp_ns or 0
        return Accuracy(
            steps=self._steps,
            localized=localized,
            final_error_m=self._final.distance_m if self._final else None,
            final_error_rad=self._final.heading_rad if self._final else None,
            localized_at_step=streak.step if streak else None,
            localized_at_s=(streak.stamp_ns - start_ns) / 1e9 if streak else None,
            confidently_wrong_fraction=_share(self._confidently_wrong, self._judged),
            truth_tracked_fraction=_share(self._tracked, self._after_search),
            truth_probability_mean=_share(self._probability, self._after_search),
            rmse_m=math.sqrt(streak.sum_m2 / streak.steps) if streak else None,
        )

    def _judge_estimate(
        self, step: int, stamp_ns: int, places: Sequence[Hypothesis], errors: Sequence[PoseError]
    ) -> None:
        self._judged += 1
        self._final = errors[0] if errors else None
        right = self._final is not None and self._final.right
        self._last_right.append(right)
        if self._final is None or not right:
            sure = bool(places) and places[0].probability >= CONFIDENT_PROBABILITY
            self._confidently_wrong += sure
            self._streak = _Streak(step, stamp_ns)
            return
        if self._streak.steps == 0:
            self._streak = _Streak(step, stamp_ns)
        self._streak.steps += 1
        self._streak.sum_m2 += self._final.distance_m**2


@dataclass
class _Streak:
    """Judged steps in a row with right estimates."""

    step: int
    stamp_ns: int
    steps: int = 0
    sum_m2: float = 0.0


def _share(part: float, whole: int) -> float | None:
    return part / whole if whole else None
