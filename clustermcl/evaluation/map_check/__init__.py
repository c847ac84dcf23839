"""Checks whether a map is suitable for localization, and whether a recording matches it."""
