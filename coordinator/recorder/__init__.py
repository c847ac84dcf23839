"""The flight recorder: what a coordinator was told, kept so that it can be replayed at a desk."""
