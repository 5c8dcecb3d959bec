"""PushT: the benchmark's episodes, and the controller that was made for its disc and its T.

`docs/howto/pusht.md` says, with figures, why the controller of the robot's finger does not play it.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
