"""How many bytes honest messages have at most; `limits` says which has how many."""

SMALL_BYTES = 64 * 1024
"""Poses, commands, answers to them: a few hundred bytes of honest content."""
SCAN_BYTES = 256 * 1024
"""20,000 beams, more than any laser has, in eight bytes each."""
LIST_BYTES = 1024 * 1024
"""Hypotheses of thousands of clusters, the list of a thousand processes."""
LARGEST_BYTES = 32 * 1024 * 1024
"""A million particles; 300 scans of 20,000 beams; the map of a square kilometre, compressed."""
