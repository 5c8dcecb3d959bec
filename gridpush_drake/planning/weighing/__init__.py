"""Weighing an object at the table's edge: where to press, and how a press is carried out."""
