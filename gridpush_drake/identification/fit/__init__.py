"""Fits of a model to pushes under hypotheses about its load, and their average."""
