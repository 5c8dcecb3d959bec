"""The whole cell in one Diagram: plant, iiwa, controllers, identifier and Meshcat."""
