"""The number of particles of each cluster: their sum is shared out by probability."""

import math

import numpy as np

from clustermcl.belief.cluster_set import Cluster, ClusterSet

SHARE_EVERY_STEPS = 20
"""Steps from one review of the clusters' numbers of particles to the next."""
SHARE_AFTER_STEPS = SHARE_EVERY_STEPS // 2
"""Steps from a review until its numbers hold. No step is created while four are undecided, so all
workers receive the order before, and resample at the same step. Snapshots, at least as frequent,
let a job that moves to another worker start after the review before."""
NEARLY = 0.8
"""A cluster keeps its number of particles while its share is at least this much of it."""


def particles_of(cluster: Cluster, clusters: ClusterSet) -> int:
    """Return the number of particles of a cluster: the maximum, a half of it, a quarter ...

    The number follows from its probability among the clusters. It stays if it is nearly right,
    because each change is an order to a worker.
    """
    shared, rules = clusters.rules.particles, clusters.settings.cluster
    if shared == 0:
        return rules.particles
    log_all = np.logaddexp.reduce([one.log_probability for one in clusters.all()])
    share = shared * math.exp(cluster.log_probability - log_all)
    wanted = min(max(share, rules.min_particles), rules.particles)
    present = cluster.particles or 0
    if NEARLY * present <= wanted < 2 * present:
        return present
    return max(round(rules.particles * 0.5 ** math.ceil(math.log2(rules.particles / wanted))), 1)


def review_particles(clusters: ClusterSet, step: int) -> None:
    """Change the number of particles of clusters whose probability has changed, now and then."""
    if step % SHARE_EVERY_STEPS:
        return
    for cluster in clusters.all():
        particles = particles_of(cluster, clusters)
        if particles != cluster.particles:
            first_step = step + SHARE_AFTER_STEPS
            clusters.change(cluster, particles=particles, particles_from=first_step)
