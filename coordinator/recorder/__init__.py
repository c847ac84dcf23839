"""The flight recorder: a coordinator's events on disk, for a replay at a desk."""
