"""The identifier as a system, and what shows its estimate."""
