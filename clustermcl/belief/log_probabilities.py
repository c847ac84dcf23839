"""The Bayes filter over clusters, in logarithms (eq. 12-17 and section 4 of the paper).

Beliefs are (K,) natural logarithms of probabilities that sum to one. So a probability of 1e-300,
which is -690 here, keeps its value.
"""

import math

import numpy as np
from numpy.typing import NDArray

LogProbabilities = NDArray[np.float64]
"""(K,) natural logarithms of probabilities that sum to one."""


def normalised_logs(log_values: NDArray[np.float64]) -> LogProbabilities:
    """Shift logarithms so that their exponentials sum to one.

    Raises:
        ValueError: none of the values is finite.
    """
    if not np.any(np.isfinite(log_values)):
        raise ValueError("no cluster has a finite probability")
    shifted = log_values - np.max(log_values)
    result: LogProbabilities = shifted - math.log(np.sum(np.exp(shifted)))
    return result


def updated(
    log_prior: LogProbabilities, log_average_likelihood: NDArray[np.float64]
) -> LogProbabilities:
    """Apply one Bayes update: prior times the average likelihood of the cluster's particles.

    A missing report (NaN) gives no information about its cluster: its probability stays, and the
    other clusters share the rest.

    Args:
        log_prior: (K,) belief before the scan.
        log_average_likelihood: (K,) log of each cluster's average likelihood, NaN where missing.

    Returns:
        (K,) belief after the scan.

    References:
        Section 4: "multiplying the prior probability of the cluster by the average of the
        likelihood of the points in that cluster". Eq. 17 has the prior twice: see docs/paper.md.
    """
    reported = ~np.isnan(log_average_likelihood)
    log_mass = np.logaddexp.reduce(log_prior[reported])
    fresh = log_prior[reported] + log_average_likelihood[reported]
    if not np.any(np.isfinite(fresh)):
        return log_prior  # no report, or a scan that is impossible everywhere: no evidence
    posterior = log_prior.copy()
    posterior[reported] = normalised_logs(fresh) + log_mass
    return normalised_logs(posterior)
