"""How Python systems, and the Diagrams that they are in, come to be freed.

Drake holds the function of an output port, or of a cache entry, for as long as the system lives. A
bound method holds the system in turn, where Python's garbage collector cannot see it: neither would
ever be freed, nor the Diagram around them. `weakly` breaks that circle. The functions of events
Drake holds weakly itself.
"""

from collections.abc import Callable
from typing import Any
from weakref import WeakMethod

NO_SLOTS: tuple[str, ...] = ()
"""`__slots__` of every class derived from a LeafSystem or a Diagram. Without it, Python gives the
class a dictionary of attributes where Drake's has one already; the collector then counts what is in
it twice, and takes it for used. Attributes are set as ever."""


def weakly(method: Callable[..., Any], *more: Any) -> Callable[..., Any]:
    """Wraps a bound method so that it does not keep its object alive.

    Further arguments come after the caller's.

    It is only called while its object lives, as Drake does with a system's.
    """
    find = WeakMethod(method)

    def call(*args: Any) -> Any:
        alive = find()
        assert alive is not None
        return alive(*args, *more)

    return call
