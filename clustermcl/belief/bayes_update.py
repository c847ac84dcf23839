"""The Bayes update of the clusters, elsewhere on this map, and off the map, by one scan."""

import math
from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from clustermcl.belief import log_probabilities as belief
from clustermcl.belief.cluster_set import ClusterSet, log_of
from clustermcl.belief.ledger import Ledger
from clustermcl.filter.laser.evidence_model import (
    contenders,
    evidence_weight,
    residual,
    scan_exponent,
    short_beam_gain,
    tempered,
    through_beam_loss,
)
from clustermcl.filter.laser.off_map import (
    BeamClasses,
    log_odds_by_decoy,
    log_odds_of_here,
    probability_right,
)
from clustermcl.protocol.work import TrackReport

PERHAPS_LIFTED = 0.2
"""Least probability of elsewhere, against all clusters, while scans fit worse than usual."""


def weigh(
    held: ClusterSet,
    reports: Mapping[str, TrackReport],
    log_likelihood_elsewhere: float = math.nan,
    *,
    observed_elsewhere: float = 0.0,
    new_view: float = 1.0,
    news: float = 1.0,
    decoy: TrackReport | None = None,
    awaits_decoy: bool = False,
    is_evidence: bool = True,
    ledger: Ledger | None = None,
) -> float:
    """Apply kidnapping, one Bayes update (eq. 12-17), and the transition between clusters.

    There are two updates in turn: which cluster is right, and whether any is. A scan that fits
    no cluster is weak evidence for the first question, and strong for the second.

    Args:
        held: the clusters, which are changed.
        reports: reports by job id; reports of ended clusters are ignored.
        log_likelihood_elsewhere: log of the scan's average likelihood over the whole map;
            NaN: unknown.
        observed_elsewhere: log average likelihood ratio of the step's observations over the
            whole map.
        new_view: share of the scan that no earlier scan has shown (`ViewMemory`).
        news: share of the scan that is new evidence of the robot being at any cluster
            (`new_share`).
        decoy: report of a job that tracks the mirrored scans; None: there is none.
        awaits_decoy: the first decoy is being searched for; classes do not count until then.
        is_evidence: the scan is evidence; that of a closed cabin only moves the clusters.
        ledger: it records which part of the update changes which log odds.

    Returns:
        Log of the scan's likelihood, averaged over the belief before the scan; a hypothesis
        outside this belief is compared with it.
    """
    elsewhere = log_likelihood_elsewhere
    if not held.clusters:
        return observed_elsewhere + (0.0 if math.isnan(elsewhere) else elsewhere)
    ordered = [reports.get(job_id) for job_id in held.job_ids]
    if not any(ordered):
        return 0.0  # nothing but evidence moves probabilities
    ledger = ledger or Ledger(held)
    update = _Update(held, ordered, news, new_view, ledger)
    update.take_poses()
    if not is_evidence:
        return 0.0
    log_here, log_there, log_off = update.kidnapped()
    among = belief.normalised_logs(held.log_probabilities()[:-2])
    ledger.note_update("lifted or brought back", among, log_here, log_there, log_off)
    among, log_scan = update.among_clusters(among)
    ledger.note_update("scan", among, log_here, log_there, log_off)
    cut_short, through = update.explained(among)
    log_scan += cut_short
    update.follow_fit(log_scan - through, float(among.max()) + log_here)
    odds = by_classes = update.log_odds_of_here(among)
    if decoy is not None:
        odds = update.compared_with_decoy(odds, among, decoy)
    elif awaits_decoy:
        odds = 0.0
    if held.given is not None:
        held.given = held.given.after(odds, new_view)
    if held.on_map:
        odds = max(odds, 0.0)
    if not math.isnan(elsewhere):
        fits_better = elsewhere - log_scan
        # People stand before the laser: where what is left of the beams fits, nothing is odd.
        log_there += news * (min(fits_better, 0.0) if odds > 0.0 else fits_better)
        log_scan += float(np.logaddexp.reduce([log_here, log_there, log_off]))
    if held.may_be_lifted:
        log_there = max(log_there, log_here + math.log(PERHAPS_LIFTED))
    here = np.append(among + log_here, (log_there, log_off))
    ledger.note_update("scan over the whole map", among, log_here, log_there, log_off)
    ledger.note_update("classes of beams", among, log_here + by_classes, log_there, log_off)
    if odds != by_classes:
        ledger.note_update("decoy", among, log_here + odds, log_there, log_off)
    weighed = here + np.append(np.full(len(among), odds), (0.0, 0.0))
    seen = update.observed(observed_elsewhere)
    held.set_log_probabilities(belief.normalised_logs(weighed + seen))
    if seen.any():
        ledger.note("observations")
        log_scan += float(np.logaddexp.reduce(belief.normalised_logs(here) + seen))
    # A candidate's beams have no classes yet: good classes of tracked places do not lower it.
    return log_scan + min(float(np.logaddexp.reduce(weighed) - np.logaddexp.reduce(here)), 0.0)


class _Update:
    """The parts of one update.

    Args:
        held: the clusters.
        reports: of each cluster; None: it has not reported.
        news: see `weigh`.
        new_view: see `weigh`.
        ledger: see `weigh`.
    """

    def __init__(
        self,
        held: ClusterSet,
        reports: Sequence[TrackReport | None],
        news: float,
        new_view: float,
        ledger: Ledger,
    ) -> None:
        self._held, self._reports, self._ledger = held, reports, ledger
        self._news, self._new_view = news, new_view
        self._evidence = np.array(
            [r.log_weight_sum - math.log(r.particles) if r else math.nan for r in reports]
        )

    @cached_property
    def _classes(self) -> dict[int, BeamClasses]:
        """The beam classes of the reports that have them, by the index of the cluster."""
        return {
            index: BeamClasses(*report.beam_classes)
            for index, report in enumerate(self._reports)
            if report and any(report.beam_classes)
        }

    def take_poses(self) -> None:
        """Take the poses of the reports; a report confirms a given pose."""
        held = self._held
        for cluster, report in zip(held.all(), self._reports, strict=True):
            if report is not None:
                held.clusters[cluster.cluster] = replace(
                    cluster,
                    pose=report.pose,
                    covariance=report.covariance,
                    effective_sample_size=report.effective_sample_size,
                    confirmed=True,
                )

    def among_clusters(self, among: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
        """Update (K,) log probabilities among the clusters; also return the scan's likelihood."""
        evidence, rules = self._evidence, self._held.rules
        reported = ~np.isnan(evidence)
        log_mass = np.logaddexp.reduce(among[reported])
        log_scan = float(np.logaddexp.reduce(among[reported] + evidence[reported]) - log_mass)
        contends = contenders(np.where(reported, among, -np.inf))
        share = self._evidence_weight(contends)
        log_ratios = tempered(evidence, contends, share, rules.evidence_noise)
        self._ledger.note_facts(
            fit=evidence - np.nanmax(evidence[contends]),
            counted=log_ratios,
            new_view=self._new_view,
        )
        among = belief.updated(among, log_ratios)
        return belief.mixed(among, rules.transition_probability * self._news), log_scan

    def observed(self, elsewhere: float) -> NDArray[np.float64]:
        """Return (K + 2,) log evidence of the step's observations; off the map, all are outliers.

        A cluster without a report gets the best evidence of any: a loss must not end it.
        """
        best = max(report.log_observed for report in self._reports if report)
        each = [report.log_observed if report else best for report in self._reports]
        return np.array([*each, elsewhere, 0.0])

    def log_odds_of_here(self, among: NDArray[np.float64]) -> float:
        """Return by how much beam classes raise the log odds of the clusters; update `quality`."""
        held, seen = self._held, self._classes
        if 0.0 in (held.rules.kidnapping_probability, held.rules.off_map_probability) or not seen:
            return 0.0
        probable = np.exp(belief.normalised_logs(among[list(seen)]))
        odds, held.quality = log_odds_of_here(
            held.quality, probable, list(seen.values()), self._new_view
        )
        return odds

    def compared_with_decoy(
        self, odds: float, among: NDArray[np.float64], decoy: TrackReport
    ) -> float:
        """Return the evidence for the clusters, given the report of a decoy."""
        held, best = self._held, self._reports[int(np.argmax(among))]
        difference = (
            best.log_likelihood_per_beam - decoy.log_likelihood_per_beam if best else math.nan
        )
        if math.isnan(difference) or not any(decoy.beam_classes):
            return odds
        classes = [BeamClasses(*decoy.beam_classes)]
        of_decoy, _ = log_odds_of_here(held.quality, np.ones(1), classes, self._new_view)
        log_here = math.log1p(-min(held.outside_clusters, 1.0 - 1e-12))
        by_fit, held.quality = log_odds_by_decoy(held.quality, difference, log_here, self._new_view)
        # Classes count only where they differ from the decoy's.
        return min(max(odds - of_decoy, min(odds, 0.0)), max(odds, 0.0)) + by_fit

    def follow_fit(self, log_scan: float, log_best: float) -> None:
        """Learn how well scans fit while the robot is localized."""
        held, rules = self._held, self._held.rules
        if rules.kidnapping_probability == 0.0:
            return
        if held.fit.has_fallen or log_best >= math.log(rules.localized_probability):
            held.fit = held.fit.after(log_scan, self._news)
        else:
            held.fit = replace(held.fit, shortfall=0.0)

    def explained(self, among: NDArray[np.float64]) -> tuple[float, float]:
        """Return the correction of a scan's log-likelihood at the clusters by beam classes [nat].

        It is 0 if beam classes are not used; the update is then exactly Bayes' rule.

        Returns:
            The gain of beams before obstacles, which people explain; and the loss of beams through
            obstacles, if nothing explained them.
        """
        held = self._held
        if held.rules.off_map_probability == 0.0:
            return 0.0, 0.0
        counts = np.array([r.beam_classes if r else (0, 0, 0, 0) for r in self._reports])
        exponents = [scan_exponent(beams, held.sensor) for beams in counts.sum(axis=1).tolist()]
        _, _, through, other = (np.exp(among) * exponents @ counts).tolist()
        return (
            other * short_beam_gain(held.quality.short, held.sensor),
            through * through_beam_loss(held.sensor),
        )

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
        back = hazard
        lifted = log_here + log_of(hazard)
        log_there = np.logaddexp.reduce(
            [held.log_elsewhere, lifted + log_of(1.0 - off), held.log_off_map + log_of(back)]
        )
        log_off = np.logaddexp(held.log_off_map + log_of(1.0 - back), lifted + log_of(off))
        return log_here + math.log1p(-hazard), float(log_there), float(log_off)

    def _evidence_weight(self, contends: NDArray[np.bool_]) -> NDArray[np.float64]:
        """Return (K,) weights of the evidence between each cluster and the contenders.

        A weight follows from the best fit among the cluster and the contenders, because an
        improbable cluster may explain the scan best.
        """
        held, new_view = self._held, self._new_view
        fit = self._fit_without_short_beams()
        fit = np.fmax(fit, np.fmax.reduce(fit[contends]))
        residuals = [residual(best, held.sensor) for best in fit.tolist()]
        if held.rules.off_map_probability > 0.0:
            # Errors of a crude map favour a wrong place as often as the true one.
            new_view /= 1.0 + held.quality.crude
        return np.array([evidence_weight(new_view, each, held.rules) for each in residuals])

    def _fit_without_short_beams(self) -> NDArray[np.float64]:
        """Return (K,) fits of the best particles without loss for the usual short beams [nat/beam].

        NaN: there is no report.
        """
        held, classes = self._held, self._classes
        fit = np.array([r.log_likelihood_per_beam if r else math.nan for r in self._reports])
        if held.rules.off_map_probability == 0.0 or not classes:
            return fit
        seen = list(classes.values())
        short = np.array([min(each.other / sum(each), held.quality.short) for each in seen])
        right = probability_right(held.quality, seen)
        fit[list(classes)] += short * right * through_beam_loss(held.sensor)
        return fit
