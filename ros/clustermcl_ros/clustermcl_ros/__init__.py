"""Cluster-MCL as a node of ROS 2, in place of nav2's AMCL."""
