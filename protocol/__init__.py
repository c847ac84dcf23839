"""Everything two processes must agree on: keys, messages, errors. No input, no output."""
