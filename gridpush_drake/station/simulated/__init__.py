"""The simulated station: one Diagram of plant, arm, gripper, camera and learner."""
