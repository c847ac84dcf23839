"""The front door: the command a person types, and the Python client."""
