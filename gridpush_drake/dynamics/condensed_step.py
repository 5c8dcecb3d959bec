"""One step of the kernel by itself, to be compared with the maximal LCP and other references."""

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridpush_drake.dynamics.kernels.call import make_method, run_kernel
from gridpush_drake.dynamics.kernels.friction import LAWS
from gridpush_drake.dynamics.kernels.friction_law import SPIN_MODELS
from gridpush_drake.dynamics.kernels.inputs import Load
from gridpush_drake.dynamics.kernels.step import CONVERGED
from gridpush_drake.dynamics.reference.maximal_lcp import STANDARD_GRAVITY
from gridpush_drake.errors import SimulationError
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters

STICTION_TOLERANCE = 1e-10
"""m/s, and share of the speed: what sticks moves less than a few of these."""


def calc_step(
    obj: GridObject,
    params: CellParameters,
    q: ArrayLike,
    nu: ArrayLike,
    wrench: ArrayLike,
    dt: float,
    *,
    friction: str = "isotropic",
    spin: Literal["coupled", "separate", "none"] = "coupled",
    g: float = STANDARD_GRAVITY,
    stiction_tolerance: float = STICTION_TOLERANCE,
) -> NDArray[np.float64]:
    """Takes one condensed inertial step at a fixed pose (`docs/theory/model.md`, section 3).

    Args:
        obj: the object.
        params: mass and friction of its cells.
        q: (3,) pose X_WB, m and rad; directions and arms are those at this pose, as in the paper's LCP.
        nu: (3,) velocity of B's origin in W, m/s, and yaw rate, rad/s.
        wrench: (3,) force in W, N, and moment about B's origin, N m.
        dt: time step, s.
        friction: "isotropic", or the paper's "lagged" directions, which are "separate" whatever `spin` says.
        spin: how the cells resist spinning, see `kernels.isotropic_friction`.
        g: gravity, m/s².
        stiction_tolerance: speed below which friction is smoothed, m/s and as a share of the speed.

    Returns:
        nu' (3,) at the end of the step, before the pose moves.

    Raises:
        SimulationError: `friction` or `spin` is none of the words, dt is not positive, or the step was not solved.
    """
    if friction not in LAWS:
        raise SimulationError(f"friction is {friction!r}; expected one of {', '.join(map(repr, LAWS))}")
    if spin not in SPIN_MODELS:
        raise SimulationError(f"spin is {spin!r}; expected one of {', '.join(map(repr, SPIN_MODELS))}")
    if not 0 < dt < np.inf:
        raise SimulationError(f"dt is {dt!r}; expected a positive number (s)")
    method = make_method(True, friction, spin, stiction_tolerance, stiction_tolerance)._replace(ahead=0.0)
    load = Load(np.zeros((2, 2)), 0.0, -1.0, np.array([wrench], dtype=np.float64), np.zeros(2))
    q, nu = np.array(q, dtype=np.float64), np.array(nu, dtype=np.float64)
    record = run_kernel(obj, params, g, method, q, nu, np.array([float(dt)]), load, np.full(2, -1), np.empty((0, 3, 0)))
    if record.statuses[0, 0] != CONVERGED:
        raise SimulationError(f"the step of {obj.name} ({obj.n} cells) was not solved")
    ux, uy, w = record.twists[0]
    c, s = np.cos(q[2]), np.sin(q[2])
    return np.array([c * ux - s * uy, s * ux + c * uy, w])
