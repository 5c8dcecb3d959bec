"""Objects found in one photograph."""
