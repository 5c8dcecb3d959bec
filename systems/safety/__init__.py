"""The guard before a real arm, and what it watches."""
