"""The protocol between processes: keys, messages, limits, errors; without input or output."""
