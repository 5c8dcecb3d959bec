"""A real arm or its twin: the station that commands it, what links the two, and the tracker."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
