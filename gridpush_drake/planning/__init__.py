"""Where to push: contact points, pushes to a goal, pre-grasp goals and their stability, exploration."""
