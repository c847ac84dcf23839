"""The soak test: real processes, a simulated robot, faults on purpose, and promises to keep."""
