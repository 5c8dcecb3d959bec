"""Kernels of searches for a steered finger's motion."""
