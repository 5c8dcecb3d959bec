"""The gripper, and the parts of an object that it can take."""
