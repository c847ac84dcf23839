"""Size classes of messages [bytes]; `limits` assigns one to each message."""

SMALL_BYTES = 64 * 1024
"""Poses, commands and their answers; a few hundred bytes are usual."""
SCAN_BYTES = 256 * 1024
"""20,000 beams, more than any laser has, of eight bytes each."""
LIST_BYTES = 1024 * 1024
"""Hypotheses of thousands of clusters, the list of a thousand processes."""
LARGEST_BYTES = 32 * 1024 * 1024
"""A million particles; 300 scans of 20,000 beams; the map of a square kilometre, compressed."""
