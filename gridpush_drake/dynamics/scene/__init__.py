"""Several objects on a table: pushed by one pusher, and by each other.

`kernels` has the compiled step and rollout, `docs/theory/model.md` the model (section 9). The
names below are imported on first use.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
