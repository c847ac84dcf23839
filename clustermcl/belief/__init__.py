"""The belief: which places are possible, and how probable each is."""
