"""Stands in for nav2's AMCL on a robot that speaks ROS 2 over rmw_zenoh; without ROS itself."""
