"""Executors: what turns a command into a motion of the arm."""
