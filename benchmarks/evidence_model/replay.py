"""The Bayes filter over places replayed on recorded evidence, for many runs at once."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import entr, expit

from benchmarks.evidence_model.records import ELSEWHERE_POSES, Record
from clustermcl.evaluation.measures import CONFIDENT_PROBABILITY

Floats = NDArray[np.float64]
LEAST_TRUTH = 0.001
"""The logarithmic score takes no probability for smaller."""
LEAST_SHARE = 1e-12
"""Floor of the first scan's posterior, also for elsewhere."""


Counted = Callable[[Floats, Floats, Floats, Floats], Floats]
"""What counts against places, from: how much worse than the best one's their log evidence is; the
best particle's log-likelihood a beam; the way driven [m] and turned [rad] since the last scan,
infinite at the first one. Shapes: (R, K), then (R, 1) each."""


@dataclass(frozen=True, kw_only=True)
class Rules:
    """How evidence changes the belief."""

    counted: Counted = lambda worse, *_: worse
    transition_probability: float = 0.0001
    elsewhere_hazard: float = 0.0
    """Probability that the robot is lifted elsewhere in a step; 0: nothing is elsewhere."""
    elsewhere_poses: int = 2048
    elsewhere_view_m: float = 0.1
    """Evidence for elsewhere is new after driving this distance, or turning by twice the number."""


@dataclass(frozen=True, eq=False)
class Replayed:
    """What R runs of at most T steps and one first scan believe; NaN or False past their ends."""

    truth: Floats
    """(R, T + 1) probability of right places, or of elsewhere while it is none of the places."""
    elsewhere: Floats
    """(R, T + 1) probability of elsewhere."""
    best: Floats
    """(R, T + 1) probability of the most probable place."""
    best_right: NDArray[np.bool_]
    """(R, T + 1) whether it is right."""
    brier: Floats
    """(R, T + 1)"""
    copies: Floats
    """(R, T + 1, C) probability at each symmetric copy of the truth."""

    @property
    def log_score(self) -> Floats:
        """(R, T + 1)"""
        return np.log(np.maximum(self.truth, LEAST_TRUTH))

    @property
    def entropy(self) -> Floats:
        """(R,) mean normalised entropy of the copies of the truth; NaN where there is but one."""
        if self.copies.shape[2] < 2:
            return np.full(len(self.copies), np.nan)
        share = self.copies / np.maximum(self.copies.sum(axis=2, keepdims=True), LEAST_SHARE)
        each = entr(share).sum(axis=2) / math.log(share.shape[2])
        return np.asarray(each.mean(axis=1))

    @property
    def sure_wrong(self) -> NDArray[np.bool_]:
        """(R, T + 1)"""
        return (self.best >= CONFIDENT_PROBABILITY) & ~self.best_right

    @property
    def sure_right_from(self) -> Floats:
        """(R,) first step with a right place of 0.9 or more; infinite where there is none."""
        sure = (self.best >= CONFIDENT_PROBABILITY) & self.best_right
        return np.where(sure.any(axis=1), sure.argmax(axis=1), np.inf)


class Stack:
    """Records side by side, filled up to the longest run and the most places."""

    def __init__(self, records: Sequence[Record]) -> None:
        runs = len(records)
        steps = max(len(r.distance_m) for r in records)
        places = max(len(r.share) for r in records)
        self.records = list(records)
        self.evidence = np.full((steps, runs, places), np.nan)
        self.fit = np.full((steps, runs), np.nan)
        self.copy = np.full((steps, runs, places), -1, np.int8)
        self.into = np.tile(np.arange(places), (steps, runs, 1))
        self.elsewhere = np.full((steps, runs, len(ELSEWHERE_POSES)), np.nan)
        self.distance_m, self.turn_rad = np.zeros((2, steps, runs))
        self.scored = np.zeros((steps, runs), np.bool_)
        self.share = np.zeros((runs, places))
        self.first_fit = np.array([[r.first_fit] for r in records])
        self.elsewhere_fit = np.full((steps, runs, len(ELSEWHERE_POSES)), np.nan)
        for run, r in enumerate(records):
            t, k = r.evidence.shape
            self.evidence[:t, run, :k], self.copy[:t, run, :k] = r.evidence, r.copy
            self.fit[:t, run] = np.nanmax(r.fit, axis=1)
            self.into[:t, run, :k], self.elsewhere[:t, run] = r.into, r.elsewhere
            self.distance_m[:t, run], self.turn_rad[:t, run] = r.distance_m, r.turn_rad
            self.scored[:t, run], self.elsewhere_fit[:t, run] = r.known, r.elsewhere_fit
            self.share[run, :k] = r.share

    def replayed(self, rules: Rules) -> Replayed:
        """Apply all steps to all runs."""
        log_places, log_odds = self._begin(rules)
        copies = max(int(self.copy.max()), 0) + 1
        everywhere = np.ones(len(self.share), np.bool_)
        rows = [self._row(log_places, log_odds, self.copy[0], everywhere, copies)]
        for t, evidence in enumerate(self.evidence):
            reported = np.isfinite(evidence)
            running = reported.any(axis=1)
            known = np.where(reported, evidence, -np.inf)
            moved = self.distance_m[t][:, None], self.turn_rad[t][:, None]
            predicted = np.logaddexp.reduce(log_places + known, axis=1)
            if rules.elsewhere_hazard > 0.0:
                changed = self._odds(t, log_odds, predicted, rules)
                log_odds = np.where(running, changed, log_odds)
            best = np.where(running, known.max(axis=1), 0.0)[:, None]
            worse = np.where(reported, best - evidence, 0.0)
            against = rules.counted(worse, self.fit[t][:, None], *moved)
            fresh = np.where(reported, _spread(log_places, rules) - against, -np.inf)
            log_places = np.where(running[:, None], _normalised(fresh), log_places)
            rows.append(self._row(log_places, log_odds, self.copy[t], self.scored[t], copies))
            self._merge(log_places, self.into[t])
        columns = zip(*rows, strict=True)
        return Replayed(*(np.stack(column, axis=1) for column in columns))

    def _begin(self, rules: Rules) -> tuple[Floats, Floats]:
        """(R, K) log probabilities of places after the first scan; (R,) log-odds of elsewhere."""
        share = np.maximum(self.share, LEAST_SHARE)
        worse = np.log(share.max(axis=1, keepdims=True) / share)
        far = np.full((len(share), 1), np.inf)
        against = rules.counted(worse, self.first_fit, far, far)
        there = np.isfinite(self.evidence[0])
        elsewhere = np.clip(1.0 - self.share.sum(axis=1), LEAST_SHARE, 1.0 - LEAST_SHARE)
        log_odds = np.log(elsewhere / (1.0 - elsewhere))
        if rules.elsewhere_hazard == 0.0:
            log_odds = np.full(len(share), -np.inf)
        return _normalised(np.where(there, -against, -np.inf)), log_odds

    def _odds(self, t: int, log_odds: Floats, predicted: Floats, rules: Rules) -> Floats:
        """(R,) log-odds of elsewhere after a step: Bayes' rule against all places together."""
        hazard, view_m = rules.elsewhere_hazard, rules.elsewhere_view_m
        lifted = np.logaddexp(log_odds, math.log(hazard)) - math.log1p(-hazard)
        new = -np.expm1(-(self.distance_m[t] + 0.5 * self.turn_rad[t]) / view_m)
        of_uniform = self.elsewhere[t, :, ELSEWHERE_POSES.index(rules.elsewhere_poses)]
        return np.asarray(lifted + new * (of_uniform - predicted))

    @staticmethod
    def _row(
        log_places: Floats,
        log_odds: Floats,
        copy: NDArray[np.int8],
        scored: NDArray[np.bool_],
        copies: int,
    ) -> tuple[NDArray[Any], ...]:
        """One step's columns of `Replayed`."""
        elsewhere = expit(log_odds)
        places = np.exp(log_places) * (1.0 - elsewhere)[:, None]
        right = copy == 0
        truth = np.where(right.any(axis=1), (places * right).sum(axis=1), elsewhere)
        brier = (1.0 - truth) ** 2 + (places**2 * ~right).sum(axis=1)
        brier += np.where(right.any(axis=1), elsewhere**2, 0.0)
        first = places.argmax(axis=1)
        best = places[np.arange(len(places)), first]
        best_right = right[np.arange(len(places)), first]
        each = [(places * (copy == index)).sum(axis=1) for index in range(copies)]
        gone = ~scored
        return (
            np.where(gone, np.nan, truth),
            np.where(gone, np.nan, elsewhere),
            np.where(gone, 0.0, best),
            best_right & scored,
            np.where(gone, np.nan, brier),
            np.stack(each, axis=1),
        )

    @staticmethod
    def _merge(log_places: Floats, into: NDArray[np.int64]) -> None:
        """Give what merged clusters have to those they are part of from now on."""
        for run, source in np.argwhere(into != np.arange(into.shape[1])):
            target = into[run, source]
            both = log_places[run, target], log_places[run, source]
            log_places[run, target], log_places[run, source] = np.logaddexp(*both), -np.inf


def _spread(log_places: Floats, rules: Rules) -> Floats:
    """The transition between places."""
    rho, alive = rules.transition_probability, np.isfinite(log_places)
    if rho == 0.0:
        return log_places
    each = math.log(rho) - np.log(np.maximum(alive.sum(axis=1, keepdims=True), 1))
    return np.where(alive, np.logaddexp(log_places + math.log1p(-rho), each), -np.inf)


def _normalised(log_values: Floats) -> Floats:
    whole = np.logaddexp.reduce(log_values, axis=-1, keepdims=True)
    return log_values - np.where(np.isfinite(whole), whole, 0.0)
