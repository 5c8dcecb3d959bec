from .separation import Separation as Separation
from .separation import SeparationOptions as SeparationOptions
from .separation import calc_clearances as calc_clearances
from .separation import plan_separating_push as plan_separating_push
from .separation import separate as separate
