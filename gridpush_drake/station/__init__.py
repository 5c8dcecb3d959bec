"""The whole cell in one Diagram: plant, robot, controllers, identifier and Meshcat."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
