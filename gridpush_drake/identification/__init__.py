"""What is learned: parameters, their spread, and what cannot be known.

`learning` has `identify` and `baselines` the searches that it is compared with. The theory is
written out in `docs/theory/identification.md`. The names below are imported on first use.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
