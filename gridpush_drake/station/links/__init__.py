"""Links between control and the world: a small protocol, and what carries it: ROS 2, a process, or an SDK of yours."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
