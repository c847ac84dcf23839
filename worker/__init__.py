"""The process that owns particles: tracks one cluster, or a share of a global search."""
