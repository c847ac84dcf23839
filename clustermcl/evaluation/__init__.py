"""Measures accuracy: localization in one process, baselines, checks of maps."""
