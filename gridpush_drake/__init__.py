"""Learn an unknown object's mass and friction by pushing it, and push it where you want it.

The public names stand in `__init__.pyi`, beside this file. They are imported on first use, so that
`import gridpush_drake` costs nothing; every subpackage does the same with its own.
"""

from typing import Any

import lazy_loader

_get_name, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("gridpush-drake")
    return _get_name(name)
