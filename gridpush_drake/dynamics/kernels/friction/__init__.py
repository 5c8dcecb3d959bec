"""Laws of friction, and how they are registered."""
