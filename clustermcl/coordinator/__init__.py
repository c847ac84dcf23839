"""The process that compares the clusters and publishes where the robot is."""
