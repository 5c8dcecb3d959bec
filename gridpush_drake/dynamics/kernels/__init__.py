"""Compiled: friction laws, contact geometry and modes, one step, its derivative, and whole pushes.

`dynamics.kernel_call` is the way in. The names below are what the rest of the project uses.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
