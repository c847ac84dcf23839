"""The commands, each with its options; `clustermcl.command` puts them together."""
