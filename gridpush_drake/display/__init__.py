"""Meshcat: its server, what is drawn in it, the legend beside it, recordings and films of them."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
