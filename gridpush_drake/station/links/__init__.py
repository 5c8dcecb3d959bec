"""Links between control and the world: a small protocol, and ROS 2 or a process that carry it."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
