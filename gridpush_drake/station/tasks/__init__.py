"""The tasks, how each is run, and what it reports."""
