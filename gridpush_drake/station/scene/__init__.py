"""What stands around the robot: table, objects, posts and camera, as a scenario has them."""
