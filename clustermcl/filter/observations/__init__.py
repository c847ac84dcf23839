"""Observations of other sensors: landmarks, positions, fields over the map."""
