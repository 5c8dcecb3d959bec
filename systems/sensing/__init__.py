"""Sensors of poses, forces and pictures, and estimators of poses."""
