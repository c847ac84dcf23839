"""Worlds: maps drawn by code, and what a robot finds there instead."""
