"""The soak test: real processes, a simulated robot, injected faults, and promises to check."""
