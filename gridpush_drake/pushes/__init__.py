"""What was observed: the push log and its CSV form, a stream cut into pushes, and importers of public data sets.

The names below are imported on first use.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
