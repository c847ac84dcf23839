"""A simulated robot: worlds, motion, odometry, lidar; publishes through `sensor_bridge`."""
