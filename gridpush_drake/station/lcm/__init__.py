"""A real robot, or its twin, over LCM: station, link, twin, and the tracker of pictures."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
