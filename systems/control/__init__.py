"""Controllers: what decides where to push, poke and grasp."""
