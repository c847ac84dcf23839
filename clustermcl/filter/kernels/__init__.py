"""Kernels compiled by numba, and the library that holds them compiled ahead."""
