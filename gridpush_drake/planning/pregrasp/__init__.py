"""Sliding to the table's edge and grasping there."""
