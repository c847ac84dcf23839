"""Converts maps of files and messages to arrays, and computes the digest of a map."""
