"""Pushing with feedback: the finger is steered while it touches the object, ten times a second."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
