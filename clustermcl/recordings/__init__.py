"""Reads recordings and maps of all formats; reads and writes run logs."""
