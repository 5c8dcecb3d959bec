"""Where to push: contact points, pushes to a goal, slides to the table's edge, and pokes."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
