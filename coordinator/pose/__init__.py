"""Where the robot is now: between steps, late, and after a power cut."""
