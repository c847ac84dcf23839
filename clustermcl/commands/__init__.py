"""The commands and their options. Each imports its module when called, so that `pose` is fast."""
