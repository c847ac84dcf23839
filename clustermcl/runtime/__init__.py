"""Settings, logs, shutdown and child processes, shared by all processes; without Zenoh."""
