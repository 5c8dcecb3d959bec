"""Slides to the table's edge with hidden masses, in simulated worlds with an edge."""
