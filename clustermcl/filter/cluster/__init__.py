"""One cluster: its particles, weights, resampling, and what its evidence is worth."""
