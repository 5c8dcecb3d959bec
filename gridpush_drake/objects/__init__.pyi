from .grid_object import GridObject as GridObject
from .object_file import PartMaterial as PartMaterial
from .object_file import PhysicalPrior as PhysicalPrior
from .object_file import find_shipped_object as find_shipped_object
from .object_file import list_shipped_objects as list_shipped_objects
from .parameters import CellParameters as CellParameters
