"""Recordings of runs, and runs shown in Rerun."""
