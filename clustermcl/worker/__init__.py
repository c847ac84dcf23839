"""The worker process, which holds particles: it tracks clusters and searches the map."""
