"""Compiled: friction laws, contact geometry and modes, one step, its derivative, and whole pushes.

The names below are what the rest of the project calls; `run_kernel` is the way in.
"""

from gridpush_drake.dynamics.kernels.call import Method, make_method, run_kernel
from gridpush_drake.dynamics.kernels.compiled import kernel
from gridpush_drake.dynamics.kernels.forward_sensitivity import OTHER
from gridpush_drake.dynamics.kernels.friction import LAWS
from gridpush_drake.dynamics.kernels.friction_law import SPIN_ARM, SPIN_MODELS, FrictionLaw
from gridpush_drake.dynamics.kernels.inputs import Load, Steps
from gridpush_drake.dynamics.kernels.step import CONVERGED
from gridpush_drake.dynamics.kernels.step_memory import MEMORY_SIZE, make_memory

__all__ = [
    "CONVERGED",
    "LAWS",
    "MEMORY_SIZE",
    "OTHER",
    "SPIN_ARM",
    "SPIN_MODELS",
    "FrictionLaw",
    "Load",
    "Method",
    "Steps",
    "kernel",
    "make_memory",
    "make_method",
    "run_kernel",
]
