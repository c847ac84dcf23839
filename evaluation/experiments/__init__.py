"""Experiments: Cluster-MCL and baselines on worlds and recordings, by seed."""
