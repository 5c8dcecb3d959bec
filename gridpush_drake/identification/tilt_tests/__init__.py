"""Learning from tilt tests at the table's edge and from lift tests."""
