"""Mass, center of mass and friction in absolute numbers."""
