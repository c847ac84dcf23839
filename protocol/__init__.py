"""What processes agree on: keys, messages, limits, errors. No input or output."""
