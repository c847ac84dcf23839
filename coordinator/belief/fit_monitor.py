"""Whether the scans still fit the map at any tracked place: how a kidnapping is noticed."""

import math

import msgspec

from particle_filter.settings import BeliefSettings


class FitState(msgspec.Struct, frozen=True):
    """What tracking is used to."""

    usual: float
    recent: float
    lost: bool


class FitMonitor:
    """Compares how well scans fit of late with what tracking is used to.

    Fed with the best cluster's log-likelihood a beam. The usual fit is a slow average over steps
    that fitted; the recent one a fast average. Lost is when the recent one falls well under.
    """

    def __init__(self, rules: BeliefSettings) -> None:
        self._rules = rules
        self.forget()

    def forget(self) -> None:
        """Start over: nothing is known of what fits."""
        self._usual = self._recent = math.nan
        self.lost = False

    def state(self) -> FitState:
        """What is known, to be handed on."""
        return FitState(self._usual, self._recent, self.lost)

    def restore(self, state: FitState) -> None:
        """Know what another has known."""
        self._usual, self._recent, self.lost = state.usual, state.recent, state.lost

    def is_usual(self, log_likelihood_per_beam: float) -> bool:
        """Whether scans that fit so well fit about as tracking is used to."""
        return self._usual - log_likelihood_per_beam <= 0.5 * self._rules.lost_fit_drop

    def update(self, log_likelihood_per_beam: float) -> None:
        """Take the best fit of one step; NaN when no cluster reported."""
        fit = log_likelihood_per_beam
        if math.isnan(fit):
            return
        if math.isnan(self._usual):
            self._usual = self._recent = fit
            return
        self._recent += (fit - self._recent) * self._rules.recent_fit_gain
        drop = self._usual - self._recent
        if self.lost:
            self.lost = drop > 0.5 * self._rules.lost_fit_drop
        else:
            self.lost = drop > self._rules.lost_fit_drop
        if not self.lost:
            self._usual += (fit - self._usual) * self._rules.usual_fit_gain
