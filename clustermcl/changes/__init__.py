"""What has changed in the building: collected while the robot is localized, and put into a map."""
