"""Weighing an object at the table's edge: where to press, and how a press is carried out.

The names below are imported on first use.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
