"""The process that weighs clusters against each other and says where the robot is."""
