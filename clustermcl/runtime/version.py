"""The version of this software; not from the metadata, as `importlib.metadata` takes 2.5 MB."""

VERSION = "0.1.0"
