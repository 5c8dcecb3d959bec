"""What is learned: parameters, their spread, and what cannot be known."""
