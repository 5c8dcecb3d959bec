"""What an object is: cells, outline, per-cell parameters, and the files of objects.

The names below are imported on first use.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
