"""What measures accuracy: one process, baselines, experiments."""
