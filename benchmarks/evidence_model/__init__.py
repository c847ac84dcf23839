"""Records what clusters say of scans where the truth is known, and fits the evidence model to it."""
