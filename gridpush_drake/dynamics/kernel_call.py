"""The call of the compiled kernel: objects in, arrays through, a record of the steps out."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.dynamics.friction import SPIN_ARM
from gridpush_drake.dynamics.rollout import rollout
from gridpush_drake.dynamics.step_memory import make_memory
from gridpush_drake.grid.object import GridObject
from gridpush_drake.grid.parameters import CellParameters

Array = NDArray[np.float64]


class Load(NamedTuple):
    """What drives the body during T steps.

    Attributes:
        tip: (T+1, 2) the disc's centre, m.
        path_length: of the disc's whole path, m.
        radius: of the disc, m; negative where there is no pusher.
        wrench: (T, 3) force in W, N, and a couple, N m.
        point: (2,) where the force acts, body frame, m.
    """

    tip: Array
    path_length: float
    radius: float
    wrench: Array
    point: Array


class Method(NamedTuple):
    """How the steps are taken.

    Attributes:
        inertial: the regime.
        lagged: whether friction follows the paper's lagged directions.
        spin: the spin model, see `friction`.
        ahead: share of a step after which it looks at the body.
        stiction: tolerance of the inertial regime, m/s.
        relative_stiction: the least tolerance, as a share of the speed.
    """

    inertial: bool
    lagged: bool
    spin: str
    ahead: float
    stiction: float
    relative_stiction: float


class Steps(NamedTuple):
    """What the kernel records of T steps, W unless said otherwise.

    Attributes:
        poses: (T+1, 3), m and rad.
        twists: (T, 3) of B's origin, in the frame of the step (the body's, turned by ahead dt times the last yaw rate).
        velocities: (T+1, 3) of B's origin, m/s and rad/s.
        contact_forces: (T, 2, 2), N.
        contact_points: (T, 2, 2), m.
        modes: (T, 2) contact modes.
        gaps: (T+1,), m.
        statuses: (T, 2) status and iterations.
    """

    poses: Array
    twists: Array
    velocities: Array
    contact_forces: Array
    contact_points: Array
    modes: NDArray[np.int64]
    gaps: Array
    statuses: NDArray[np.int64]


def run_kernel(
    obj: GridObject,
    params: CellParameters,
    gravity: float,
    method: Method,
    q: Array,
    nu: Array,
    dts: Array,
    load: Load,
    row_of_step: NDArray[np.int64],
    J: Array,
    memory: Array | None = None,
) -> Steps:
    """Simulates T steps.

    Args:
        obj: the object.
        params: its cells' masses and frictions.
        gravity: m/s².
        method: how the steps are taken.
        q: (3,) pose at the beginning.
        nu: (3,) velocity of B's origin, m/s, and yaw rate, rad/s, at the beginning.
        dts: (T,) steps, s.
        load: what drives the body.
        row_of_step: (T+1,) row of J that records this step, -1 for none.
        J: (rows, 3, n + OTHER) filled; without columns where no derivative is wanted.
        memory: (MEMORY_SIZE,) of the step before, updated in place; a body that was at rest by default.

    Returns:
        The record.
    """
    steps = len(dts)
    k = params.friction * params.mass * gravity
    arm = SPIN_ARM * obj.cell_size
    coupled, separate = method.spin == "coupled", method.spin == "separate"
    spin = np.array([arm**2 if coupled else 0.0, k.sum() * arm if separate else 0.0, arm if separate else 0.0])
    cells, edges, previous = _outline_arrays(obj)
    record = Steps(
        np.empty((steps + 1, 3)), np.empty((steps, 3)), np.empty((steps + 1, 3)), np.empty((steps, 2, 2)),
        np.empty((steps, 2, 2)), np.empty((steps, 2), np.int64), np.empty(steps + 1), np.empty((steps, 2), np.int64),
    )  # fmt: skip
    rollout(
        cells, k, spin, method.lagged, method.ahead, edges, previous, load.radius, params.contact_friction,
        _make_moments(obj, params), method.inertial, np.array([method.stiction, method.relative_stiction]), q, nu,
        load.tip, load.path_length, dts, load.wrench, load.point, row_of_step, *record, J,
        make_memory() if memory is None else memory,
    )  # fmt: skip
    return record


def _make_moments(obj: GridObject, params: CellParameters) -> Array:
    """Mass, centre of mass, inertia about it, radius of gyration, cell size: kg, m, m, kg m², m, m."""
    com = params.centre_of_mass(obj)
    return np.array([params.total_mass, com[0], com[1], params.inertia(obj), obj.radius_of_gyration, obj.cell_size])


def _outline_arrays(obj: GridObject) -> tuple[Array, Array, NDArray[np.int64]]:
    """Cells and outline as the kernel wants them, made once an object.

    They are writable copies: for arrays that are not, Numba would compile the kernel once more.
    """
    cached = obj.__dict__.get("_kernel_arrays")
    if cached is None:
        edges = obj.edges
        cached = (
            np.array(obj.p_BC.T, order="C"),
            np.array(np.column_stack([edges.start, edges.end]).T, order="C"),
            np.array(edges.previous),
        )
        obj.__dict__["_kernel_arrays"] = cached
    return cached
