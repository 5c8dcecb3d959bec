"""Where to push: contact points, pushes to a goal, pre-grasp goals and their stability, exploration."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
