"""From a robot, a recording or a simulator to numbered, gated, synchronised scans."""
