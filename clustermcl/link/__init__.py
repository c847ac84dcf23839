"""Zenoh: session, inbox, wire, router, access control, health."""
