"""Decides what a node in the place of nav2's AMCL does; the node is `ros/clustermcl_ros`."""
