"""What a worker does with particles, and the same in one process."""
