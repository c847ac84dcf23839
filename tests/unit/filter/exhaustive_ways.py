"""The best way of two equally probable places by trying all, as an oracle for `advised_ways`."""

import heapq
import itertools
import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from scipy.stats import norm

from clustermcl.filter.advice.advice import Question
from clustermcl.filter.arrays import FREE, Cells, Pose
from clustermcl.filter.laser.evidence_model import evidence_weight, scan_exponent
from clustermcl.filter.laser.likelihood_field_model import LikelihoodFieldModel
from clustermcl.filter.poses import compose
from clustermcl.filter.settings import FilterSettings
from tests.unit.filter.naive_rays import cast_rays
from tests.unit.filter.rooms import CELL_M, model_of

Node = tuple[int, int]
STEP_M = 0.2
MARGIN_M = 0.1
TURN_M, BEGINNING_M = 0.3, 5.0
"""What a radian costs, and what is added to each length (docs/tutorials/planner.md) [m]."""
_OFF_M, _OFF_RAD = (0.0, -0.075, -0.0375, 0.0375, 0.075), (0.0, -0.03, -0.015, 0.015, 0.03)
OFF = np.array([*itertools.product(_OFF_M, _OFF_M, _OFF_RAD)])
"""(125, 3) errors of a place that are no evidence: x, y [m], heading [rad]."""


class ExhaustiveSearch:
    """All ways on a lattice, each with its score."""

    def __init__(self, cells: Cells, asked: Question) -> None:
        assert len(asked.places) == 2
        assert np.ptp(asked.probabilities) == 0.0
        self._cells, self._asked, self._settings = cells, asked, FilterSettings()
        self._model: LikelihoodFieldModel = model_of(cells)
        self._clear_m = np.asarray(distance_transform_edt(cells == FREE)) * CELL_M
        self._evidence: dict[Node, NDArray[np.float64]] = {}

    def scores(self) -> dict[Node, float]:
        """Return the score of the shortest way to each node."""
        return {node: self._score(way) for node, way in self._ways().items() if len(way) > 1}

    def _is_free(self, node: Node) -> bool:
        for place in self._asked.places:
            x, y, _ = compose(place, _pose(node))
            row, column = int(y / CELL_M), int(x / CELL_M)
            inside = 0 <= row < self._cells.shape[0] and 0 <= column < self._cells.shape[1]
            if not inside or self._clear_m[row, column] < self._asked.radius_m + MARGIN_M:
                return False
        return True

    def _ways(self) -> dict[Node, list[Node]]:
        """Return the shortest way from the robot to each node (Dijkstra)."""
        ways: dict[Node, list[Node]] = {}
        waiting = [(0.0, [(0, 0)])]
        while waiting:
            cost, way = heapq.heappop(waiting)
            i, j = way[-1]
            if (i, j) in ways:
                continue
            ways[i, j] = way
            for di, dj in itertools.product((-1, 0, 1), repeat=2):
                node = (i + di, j + dj)
                if node not in ways and self._is_free(node):
                    heapq.heappush(waiting, (cost + math.hypot(di, dj), [*way, node]))
        return ways

    def _score(self, way: list[Node]) -> float:
        rules, asked = self._settings.belief, self._asked
        per_metre = -math.expm1(-asked.gate_m / rules.view_distance_m) / asked.gate_m
        per_radian = -math.expm1(-asked.gate_rad / rules.view_turn_rad) / asked.gate_rad
        effort_m, heading, evidence = BEGINNING_M, 0.0, np.zeros(2)
        for before, node in itertools.pairwise(way):
            along = np.subtract(node, before)
            length_m, ahead = STEP_M * math.hypot(*along), math.atan2(along[1], along[0])
            turn_rad = abs(math.remainder(ahead - heading, math.tau))
            effort_m, heading = effort_m + length_m + TURN_M * turn_rad, ahead
            evidence += (length_m * per_metre + turn_rad * per_radian) * self._evidence_at(node)
        information = float(np.mean(math.log(2.0) - np.log1p(np.exp(-evidence))))
        needed = math.log(rules.localized_probability / (1.0 - rules.localized_probability))
        sure = norm.cdf((evidence - needed) / np.sqrt(2.0 * evidence + 1e-9)).mean()
        return (information / math.log(2.0) + float(sure)) / effort_m

    def _evidence_at(self, node: Node) -> NDArray[np.float64]:
        """Return (2,) what a scan there tells for each place, if it is right [nat]."""
        if node not in self._evidence:
            self._evidence[node] = np.array([self._told(node, k) for k in (0, 1)])
        return self._evidence[node]

    def _told(self, node: Node, right: int) -> float:
        asked, laser = self._asked, self._asked.laser
        at = [compose(place, _pose(node)) for place in asked.places]
        ranges = cast_rays(self._cells, CELL_M, at[right], laser.angles, laser.range_max_m)
        beams = self._model.beams(replace(laser, ranges=ranges))
        if beams.count == 0:
            return 0.0
        fits = [float(self._model.log_likelihood(pose + OFF, beams).max()) for pose in at]
        exponent = scan_exponent(beams.count, self._settings.sensor)
        told = exponent * max(fits[right] - fits[1 - right], 0.0)
        rules = self._settings.belief
        worth = evidence_weight(1.0, asked.residual, rules)
        return worth * told**2 / (told + rules.evidence_noise) if told else 0.0


def _pose(node: Node) -> Pose:
    return np.array([STEP_M * node[0], STEP_M * node[1], 0.0])
