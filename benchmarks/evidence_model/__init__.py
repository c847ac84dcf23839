"""Records what clusters say of scans, and fits the evidence model to it."""
