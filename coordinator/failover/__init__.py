"""How one coordinator takes over from another, and when it must not act."""
