"""Search of a whole map: branch and bound, and clusters of what it finds."""
