"""The Bayes update of the clusters, elsewhere on this map, and off the map, by one scan."""

import math
from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from clustermcl.belief import log_probabilities as belief
from clustermcl.belief.cluster_set import ClusterSet, log_of
from clustermcl.belief.explained import NO_PLACE, Explained, explains
from clustermcl.belief.ledger import Ledger
from clustermcl.filter.laser.beam_fits import decoded
from clustermcl.filter.laser.evidence_model import scan_exponent, short_beam_gain, through_beam_loss
from clustermcl.protocol.work import ElsewhereReport, TrackReport

PERHAPS_LIFTED = 0.2
"""Least probability of elsewhere, against all clusters, while scans fit worse than usual."""
OPEN = 0.02
"""A decoy is tracked while the robot is off the map with a higher probability than this."""
SHORT_LEARNED = 0.15
"""Weight of a scan in the share of short beams."""
MISSED = 0.25
"""A beam that fits less, and is not through a wall, is short."""


def weigh(
    held: ClusterSet,
    reports: Mapping[str, TrackReport],
    elsewhere: ElsewhereReport | None = None,
    *,
    beams: NDArray[np.float64] | None = None,
    news: float = 1.0,
    unseen: float | None = None,
    decoy: float | None = None,
    ledger: Ledger | None = None,
) -> None:
    """Apply kidnapping and one Bayes update (eq. 12-17).

    There are two updates in turn: which cluster is right, and whether any is. A scan that fits
    no cluster is weak evidence for the first question, and strong for the second.

    Args:
        held: the clusters, which are changed.
        reports: reports by job id; reports of ended clusters are ignored.
        elsewhere: how well the scan fits on average over the whole map; None: unknown.
        beams: (B,) how new the pieces are at which the beams end (`Pieces`); None: unknown.
        news: share of the scan that is new evidence of the robot being at any cluster
            (`new_share`).
        unseen: share of the scan whose pieces of wall are new, and so count for elsewhere; None:
            `news`.
        decoy: evidence of the new beams at places of the mirrored robot [nat]; None: unknown.
        ledger: it records which part of the update changes which log odds.
    """
    ordered = [reports.get(job_id) for job_id in held.job_ids]
    if not any(ordered):
        return  # nothing but evidence moves probabilities
    ledger = ledger or Ledger(held)
    update = _Update(held, ordered, news, beams, ledger)
    log_here, log_there, log_off = update.kidnapped()
    among = belief.normalised_logs(held.log_probabilities()[:-2])
    ledger.note("lifted or brought back", np.append(among + log_here, (log_there, log_off)))
    among, log_scan = update.among_clusters(among)
    ledger.note("scan", np.append(among + log_here, (log_there, log_off)))
    cut_short, through = update.corrections(among)
    log_scan += cut_short
    update.follow_fit(log_scan - through, float(among.max()) + log_here)
    odds = update.log_odds_of_here(among, decoy)
    misses = update.missed(among)
    if held.given is not None:
        held.given = held.given.after(misses, news)
    if held.on_map:
        odds = max(odds, 0.0)
    if elsewhere is not None and not math.isnan(elsewhere.log_likelihood):
        fits_better = elsewhere.log_likelihood - log_scan
        # People stand before the laser: where what is left of the beams fits, nothing is odd.
        log_there += (news if unseen is None else unseen) * (
            min(fits_better, 0.0) if misses < 0.0 else fits_better
        )
    if held.fit.has_fallen and not held.on_map:
        log_there = max(log_there, log_here + math.log(PERHAPS_LIFTED))
    after = np.append(among + log_here, (log_there, log_off))
    ledger.note("scan over the whole map", after)
    after[:-2] += odds
    ledger.note("beams through walls", after)
    seen = update.observed(elsewhere.log_observed if elsewhere else 0.0)
    held.set_log_probabilities(belief.normalised_logs(after + seen))
    if seen.any():
        ledger.note("observations")


class _Update:
    """The parts of one update; None: a cluster has not reported."""

    def __init__(
        self,
        held: ClusterSet,
        reports: Sequence[TrackReport | None],
        news: float,
        beams: NDArray[np.float64] | None,
        ledger: Ledger,
    ) -> None:
        self._held, self._reports, self._ledger = held, reports, ledger
        self._news, self._per_piece = news, held.piece_evidence
        self._beams = np.zeros(0) if beams is None else beams
        self._new = float(self._beams.sum())
        self._evidence = np.array(
            [r.log_weight_sum - math.log(r.particles) if r else math.nan for r in reports]
        )

    @cached_property
    def _explained(self) -> dict[int, Explained]:
        """What each place explains of the new beams; see `explains`."""
        beams, sharpness, reports = self._beams, self._held.sharpness, enumerate(self._reports)
        return {i: found for i, r in reports if r and (found := explains(r, beams, sharpness))}

    def among_clusters(self, among: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
        """Update (K,) log probabilities among the clusters; also return the scan's likelihood."""
        evidence, rules = self._evidence, self._held.rules
        reported = ~np.isnan(evidence)
        log_mass = np.logaddexp.reduce(among[reported])
        log_scan = float(np.logaddexp.reduce(among[reported] + evidence[reported]) - log_mass)
        if rules.piece_evidence > 0.0:
            evidence = self._of_pieces()
            self._learn(np.exp(belief.updated(among, evidence)))
        self._ledger.note_facts(
            fit=self._evidence - np.nanmax(self._evidence),
            counted=evidence - np.fmax.reduce(evidence),
            new_pieces=self._new,
        )
        return belief.updated(among, evidence), log_scan

    def _of_pieces(self) -> NDArray[np.float64]:
        """Return (K,) evidence of what is new of the scan [nat]; NaN: unknown.

        At a wrong place most of it fits only behind mapped walls; at the right one, only where the
        building has changed.
        """
        held, changed = self._held, self._held.changed
        among = held.learned.evidence_among(held.best.familiarity, changed)
        evidence = np.full(len(self._reports), math.nan)
        for index, found in self._explained.items():
            evidence[index] = among * (found.clear + changed * (found.fitting - found.clear))
        return evidence

    def _learn(self, shares: NDArray[np.float64]) -> None:
        """Learn how much of what is new the places explain."""
        held, every, found = self._held, self._held.all(), self._explained
        for index, each in found.items():
            known = every[index].familiarity.after(self._new, each.fitting)
            held.change(every[index], familiarity=known)
        best = held.best.cluster
        of_all = [(float(shares[i]), each, every[i].cluster == best) for i, each in found.items()]
        held.learned = held.learned.after(self._new, of_all)

    def observed(self, elsewhere: float) -> NDArray[np.float64]:
        """Return (K + 2,) log evidence of the step's observations; off the map, all are outliers.

        A cluster without a report gets the best evidence of any: a loss must not end it.
        """
        best = max(report.log_observed for report in self._reports if report)
        each = [report.log_observed if report else best for report in self._reports]
        return np.array([*each, elsewhere, 0.0])

    def log_odds_of_here(self, among: NDArray[np.float64], decoy: float | None) -> float:
        """Return by how much the scan raises the log odds of the clusters against all else.

        Elsewhere and off the map explain as much of it as the decoy, and at least `NO_PLACE`. While
        there is no decoy and the robot may be off the map, they explain as much as the clusters.
        """
        rules, explained = self._held.rules, self._explained
        if 0.0 in (rules.kidnapping_probability, rules.off_map_probability) or not explained:
            return 0.0
        clear = self._per_piece * np.array([each.clear for each in explained.values()])
        here = float(np.logaddexp.reduce(belief.normalised_logs(among[list(explained)]) + clear))
        other = NO_PLACE * self._per_piece * self._new
        if decoy is not None:
            other = max(other, decoy)
        elif self._held.off_map > OPEN:
            other = max(other, here)
        return here - other

    def missed(self, among: NDArray[np.float64]) -> float:
        """Return by how much more beams are through walls than explained, at the clusters."""
        found = self._explained
        if not found:
            return 0.0
        share = np.exp(belief.normalised_logs(among[list(found)]))
        each = [place.through - place.clear for place in found.values()]
        return self._per_piece * float(share @ each)

    def follow_fit(self, log_scan: float, log_best: float) -> None:
        """Learn how well scans fit while the robot is localized."""
        held, rules = self._held, self._held.rules
        if rules.kidnapping_probability == 0.0:
            return
        if held.fit.has_fallen or log_best >= math.log(rules.localized_probability):
            held.fit = held.fit.after(log_scan, self._news)
        else:
            held.fit = replace(held.fit, shortfall=0.0)

    def corrections(self, among: NDArray[np.float64]) -> tuple[float, float]:
        """Return by how much a scan's log-likelihood at the clusters is corrected [nat].

        The gain is of beams before obstacles, which people explain; the loss is of beams through
        obstacles, as if nothing explained them. Both are 0 if the robot cannot be off the map; the
        update is then exactly Bayes' rule.
        """
        held, sensor = self._held, self._held.settings.sensor
        if held.rules.off_map_probability == 0.0:
            return 0.0, 0.0
        counts = np.array([_counts(r) if r else (0, 0, 0) for r in self._reports])
        exponents = [scan_exponent(beams, sensor) for beams in counts[:, 0].tolist()]
        beams, short, through = (np.exp(among) * exponents @ counts).tolist()
        gain = short * short_beam_gain(held.short, sensor)
        if beams > 0.0:
            held.short += SHORT_LEARNED * self._news * (short / beams - held.short)
        return gain, through * through_beam_loss(sensor)

    def kidnapped(self) -> tuple[float, float, float]:
        """Return log probabilities of all clusters together, of elsewhere, and of off the map.

        The robot may have been lifted or brought back to the map since the last scan.
        """
        held = self._held
        hazard = held.rules.kidnapping_probability * self._news
        log_here = float(np.logaddexp.reduce(held.log_probabilities()[:-2]))
        if hazard == 0.0:
            return log_here, held.log_elsewhere, held.log_off_map
        off = 0.0 if held.on_map else held.rules.off_map_probability
        lifted = log_here + log_of(hazard)
        log_there = np.logaddexp.reduce(
            [held.log_elsewhere, lifted + log_of(1.0 - off), held.log_off_map + log_of(hazard)]
        )
        log_off = np.logaddexp(held.log_off_map + log_of(1.0 - hazard), lifted + log_of(off))
        return log_here + math.log1p(-hazard), float(log_there), float(log_off)


def _counts(report: TrackReport) -> tuple[int, int, int]:
    """Return the numbers of beams, of those that end before any obstacle, and through walls."""
    fits, through = decoded(report.fits)
    short = np.count_nonzero((fits < MISSED) & ~through)
    return len(fits), int(short), int(np.count_nonzero(through))
