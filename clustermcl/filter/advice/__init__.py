"""Where to drive so that scans distinguish the places."""
