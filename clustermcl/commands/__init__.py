"""The commands and their options. A command imports its module when called, as most are slow."""
