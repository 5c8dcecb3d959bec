from .closed_loop import LoopOptions as LoopOptions
from .push_constraints import PushConstraints as PushConstraints
from .simulated_world import PushWorld as PushWorld
from .simulated_world import SimulatedWorld as SimulatedWorld
from .simulated_world import run_loop as run_loop
from .support_surface import SupportSurface as SupportSurface
