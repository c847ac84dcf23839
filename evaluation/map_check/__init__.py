"""Is a map fit for localizing, and does a recording agree with it."""
