"""The flight recorder: it writes a coordinator's events to disk for an offline replay."""
