"""How an object moves when it is pushed: pushes, their simulation, and the resulting motion.

`kernels` has the compiled step and rollout, `reference` the paper's own, slow forms that they are
tested against. The model is written out in `docs/theory/model.md`. The names below are imported on
first use.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
