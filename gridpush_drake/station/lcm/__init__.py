"""A real robot, or its twin, over LCM: the station, the link to the robot, the twin, and what tracks the object."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
