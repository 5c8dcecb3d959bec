"""How an object moves when it is pushed: pushes, the simulation of one, and the motion that comes of it.

`kernels` has the compiled step and rollout, `reference` the paper's own, slow forms that they are tested against. The
model is written out in `docs/theory/model.md`. The names below are imported on first use.
"""

from typing import TYPE_CHECKING

from gridpush_drake.lazy import make_lazy_names

if TYPE_CHECKING:
    from gridpush_drake.dynamics.condensed_step import calc_step
    from gridpush_drake.dynamics.motion import Jacobian, Motion, MotionStatus
    from gridpush_drake.dynamics.push import ForcePush, Push
    from gridpush_drake.dynamics.simulation import GRAVITY, Regime, simulate, simulate_batch
    from gridpush_drake.dynamics.time_grid import DEFAULT_DT, DEFAULT_TIP_STEP, make_path_times

__all__ = [
    "DEFAULT_DT",
    "DEFAULT_TIP_STEP",
    "GRAVITY",
    "ForcePush",
    "Jacobian",
    "Motion",
    "MotionStatus",
    "Push",
    "Regime",
    "calc_step",
    "make_path_times",
    "simulate",
    "simulate_batch",
]

_HOMES = {
    "DEFAULT_DT": "time_grid",
    "DEFAULT_TIP_STEP": "time_grid",
    "GRAVITY": "simulation",
    "ForcePush": "push",
    "Jacobian": "motion",
    "Motion": "motion",
    "MotionStatus": "motion",
    "Push": "push",
    "Regime": "simulation",
    "calc_step": "condensed_step",
    "make_path_times": "time_grid",
    "simulate": "simulation",
    "simulate_batch": "simulation",
}

__getattr__ = make_lazy_names(globals(), _HOMES)
