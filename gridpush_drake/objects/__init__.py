"""What an object is: cells, outline, per-cell parameters, and the files of objects.

The names below are imported on first use.
"""

from typing import TYPE_CHECKING

from gridpush_drake.lazy import make_lazy_names

if TYPE_CHECKING:
    from gridpush_drake.objects.grid_object import GridObject
    from gridpush_drake.objects.object_file import find_shipped_object, list_shipped_objects
    from gridpush_drake.objects.parameters import CellParameters
    from gridpush_drake.objects.prior import PhysicalPrior

__all__ = ["CellParameters", "GridObject", "PhysicalPrior", "find_shipped_object", "list_shipped_objects"]

_HOMES = {
    "CellParameters": "parameters",
    "GridObject": "grid_object",
    "PhysicalPrior": "prior",
    "find_shipped_object": "object_file",
    "list_shipped_objects": "object_file",
}

__getattr__ = make_lazy_names(globals(), _HOMES)
