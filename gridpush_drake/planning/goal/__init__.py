"""Pushing to a goal pose."""
