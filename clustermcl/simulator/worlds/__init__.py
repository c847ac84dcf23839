"""Simulated worlds: a map for the localizer, and the true map."""
