"""How a robot moves: noise of odometry, motion models, trajectories."""
