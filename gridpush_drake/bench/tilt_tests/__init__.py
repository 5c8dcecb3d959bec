"""How well mass, center of mass and friction are found by tests at the table's edge."""
