"""The call of the compiled rollout: objects in, arrays through, a record of the steps out."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.dynamics.kernels.contact import Edges
from gridpush_drake.dynamics.kernels.friction import LAWS
from gridpush_drake.dynamics.kernels.friction_law import calc_spin_arm
from gridpush_drake.dynamics.kernels.inputs import Array, Body, Load, Pushes, Scheme, Steps
from gridpush_drake.dynamics.kernels.rollout import rollout, rollout_pushes
from gridpush_drake.dynamics.kernels.step_memory import make_memory
from gridpush_drake.dynamics.kernels.step_start import make_state
from gridpush_drake.dynamics.kernels.support_loads import Support, find_loads, make_loads
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters

AHEAD = 0.5
"""Share of a step after which it looks at the body: the midpoint rule."""


class Method(NamedTuple):
    """How the steps are taken, in words.

    Attributes:
        inertial: the regime.
        friction: the law's name, see `friction.LAWS`.
        spin: the spin model, see `isotropic_friction`.
        ahead: share of a step after which it looks at the body.
        stiction: tolerance of the inertial regime, m/s.
        relative_stiction: the least tolerance, as a share of the speed.
    """

    inertial: bool
    friction: str
    spin: str
    ahead: float
    stiction: float
    relative_stiction: float


def make_method(
    inertial: bool, friction: str, spin: str, stiction: float, relative_stiction: float
) -> Method:
    """Makes a method; the law decides where its steps look at the body, and replaces a spin model it does not know."""
    law = LAWS[friction]
    ahead = AHEAD if law.looks_ahead else 0.0
    return Method(
        inertial, friction, law.choose_spin(spin), ahead, float(stiction), float(relative_stiction)
    )


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
    table: Array | None = None,
) -> Steps:
    """Simulates T steps.

    Args:
        obj: the object.
        params: its cells' masses and frictions.
        gravity: m/s².
        method: how the steps are taken.
        q: (3,) pose at the beginning.
        nu: (3,) velocity of B's origin, m/s, and yaw rate, rad/s, at the beginning.
        dts: (T,) steps, s, or as `push.measure_steps` has them; the velocities are by the same.
        load: what drives the body.
        row_of_step: (T+1,) row of J that records this step, -1 for none.
        J: (rows, 3, width) filled, see `forward_sensitivity`; without columns where no derivative
            is wanted.
        memory: (MEMORY_SIZE,) of the step before, updated in place; a body that was at rest by
            default.
        table: (K, 4) edges of the table's top, m, see `Support`; without any it is endless.

    Returns:
        The record.
    """
    steps = len(dts)
    prepared = _prepare(obj, params, gravity, method, table)
    record = Steps(
        np.empty((steps + 1, 3)), np.empty((steps, 3)), np.empty((steps + 1, 3)), np.empty((steps, 2, 2)),
        np.empty((steps, 2, 2)), np.empty((steps, 2), np.int64), np.empty(steps + 1), np.empty((steps, 2)),
        np.empty(steps, np.bool_), np.empty((steps, 2), np.int64),
    )  # fmt: skip
    rollout(
        *prepared,
        load,
        q,
        nu,
        dts,
        row_of_step,
        record,
        J,
        make_memory() if memory is None else memory,
    )
    return record


def run_pushes(
    obj: GridObject,
    params: CellParameters,
    gravity: float,
    method: Method,
    pushes: Pushes,
    row_of_step: NDArray[np.int64],
    J: Array,
    rows: int,
    table: Array | None = None,
) -> tuple[Array, NDArray[np.bool_]]:
    """Simulates many pushes of one object in one call; arguments as of `run_kernel` and `rollout_pushes`.

    Returns:
        The poses (rows, 3) that are recorded, and whether the object was touched (P,).
    """
    poses, touched = np.empty((rows, 3)), np.empty(len(pushes.radii), np.bool_)
    rollout_pushes(
        *_prepare(obj, params, gravity, method, table), pushes, row_of_step, poses, touched, J
    )
    return poses, touched


def _prepare(
    obj: GridObject, params: CellParameters, gravity: float, method: Method, table: Array | None
) -> tuple[Any, Body, Support, Any, Scheme]:
    """The rollout's first arguments: law, body, support, outline and scheme."""
    cells, edges = _outline_arrays(obj)
    body = _make_body(obj, params, gravity, method.inertial, cells)
    support = make_support(obj, params, gravity, table)
    k = body.k.copy() if support.active else body.k
    law = LAWS[method.friction].make(k, calc_spin_arm(obj, params), method.spin)
    return (
        law,
        body,
        support,
        edges,
        Scheme(method.inertial, method.ahead, method.stiction, method.relative_stiction),
    )


def _make_body(
    obj: GridObject, params: CellParameters, gravity: float, inertial: bool, cells: Array
) -> Body:
    """Collects what the kernels know of the object, as floats: for other numbers Numba would compile them once more."""
    k = params.friction * params.mass * gravity
    mass = com_x = com_y = inertia = 0.0
    if inertial:
        com_x, com_y = map(float, params.center_of_mass(obj))
        mass, inertia = float(params.total_mass), float(params.inertia(obj))
    size, friction = float(obj.cell_size), float(params.contact_friction)
    return Body(
        cells, k, mass, com_x, com_y, inertia, float(obj.radius_of_gyration), size, friction
    )


def shifts_loads(params: CellParameters, table: Array | None) -> bool:
    """Whether loads shift at all: by the pusher's height, or over the table's edge."""
    return params.push_height > 0 or table is not None


def make_support(
    obj: GridObject, params: CellParameters, gravity: float, table: Array | None
) -> Support:
    """Collects what the loads depend on; `table` as in `run_kernel`."""
    if not shifts_loads(params, table):
        return Support(
            False, np.empty(0), np.empty(0), 0.0, 0.0, 0.0, 0.0, 0.0, np.empty(0), np.empty(0),
            np.empty(0, np.int64), np.empty(0, np.int64), np.empty((0, 4)),
        )  # fmt: skip
    com_x, com_y = map(float, params.center_of_mass(obj))
    return Support(
        True, params.mass.copy(), params.friction.copy(), params.total_mass * gravity, com_x, com_y, params.push_height,
        *_cell_lines(obj), np.empty((0, 4)) if table is None else table,
    )  # fmt: skip


def calc_reach(obj: GridObject) -> float:
    """The farthest cell's distance from B's origin, m."""
    return _cell_lines(obj)[0]


def _cell_lines(
    obj: GridObject,
) -> tuple[float, Array, Array, NDArray[np.int64], NDArray[np.int64]]:
    """The cells' reach from B's origin, m, the x and the y that occur, m, and which are each cell's; made once."""
    cached = obj.__dict__.get("_kernel_lines")
    if cached is None:
        reach = float(np.linalg.norm(obj.p_BC, axis=1).max())
        (xs, column), (ys, row) = (
            np.unique(obj.p_BC[:, axis], return_inverse=True) for axis in (0, 1)
        )
        cached = obj.__dict__["_kernel_lines"] = reach, xs, ys, column, row
    return cached


def find_rest_loads(
    obj: GridObject, params: CellParameters, gravity: float, q: Array, table: Array | None
) -> Array | None:
    """The loads (n,), N, of a body at rest at q (3,); None where there are none. `table` as in `run_kernel`."""
    cells, _ = _outline_arrays(obj)
    support = make_support(obj, params, gravity, np.empty((0, 4)) if table is None else table)
    loads = make_loads(support)
    held = find_loads(
        support,
        cells,
        float(obj.cell_size),
        make_state(q, np.zeros(3), 0.0, 0.0),
        loads,
        np.empty(obj.n),
    )
    return params.total_mass * gravity * params.mass * loads.share if held else None


def _outline_arrays(obj: GridObject) -> tuple[Array, Any]:
    """Cells and outline as the kernel wants them, made once an object.

    They are writable copies: for arrays that are not, Numba would compile the kernel once more.
    """
    cached = obj.__dict__.get("_kernel_arrays")
    if cached is None:
        edges = obj.edges
        ends = np.array(np.column_stack([edges.start, edges.end]).T, order="C")
        cached = (
            np.array(obj.p_BC.T, order="C"),
            Edges(ends[0], ends[1], ends[2], ends[3], np.array(edges.previous)),
        )
        obj.__dict__["_kernel_arrays"] = cached
    return cached
