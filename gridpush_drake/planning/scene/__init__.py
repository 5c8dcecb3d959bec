"""Tasks with several objects: to bring them to goals, and to move those that touch apart.

The names below are imported on first use.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
