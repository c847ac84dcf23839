"""Experiments: what the system is held against, on worlds and recordings, by seed."""
