"""Measures accuracy: localization in one process, baselines, experiments."""
