"""A page in the browser that shows where the robot may be."""
