"""The call of the compiled rollout: objects in, arrays through, a record of the steps out.

This is the one place where an object, its parameters and a `Physics` become the named tuples of
`kernels.inputs`. It checks nothing: `simulation`, `push_batch` and `GridLcpSystem` do, before they
come here.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.dynamics.bodies import Bodies
from gridpush_drake.dynamics.cell_pooling import POOLED_FROM, CellPooling
from gridpush_drake.dynamics.kernels.contact.contact import Edges
from gridpush_drake.dynamics.kernels.friction.friction_law import calc_spin_lever_arm
from gridpush_drake.dynamics.kernels.friction.isotropic_friction import Isotropic
from gridpush_drake.dynamics.kernels.inputs import Body, Load, Pushes, Scheme, Steps, make_record
from gridpush_drake.dynamics.kernels.rollout import rollout, rollout_pushes
from gridpush_drake.dynamics.kernels.step_memory import make_memory
from gridpush_drake.dynamics.kernels.step_start import make_state
from gridpush_drake.dynamics.kernels.support_loads import Support, find_loads, make_loads
from gridpush_drake.dynamics.physics import Physics
from gridpush_drake.geometry.se2 import Array, IntArray
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters

EARLY_END = 1e-4
"""Residual of a step, as a fraction of the load, from which one more Newton step is taken to solve
it where poses may be approximate: it leaves about the square of this."""


def run_kernel(
    bodies: Bodies,
    *,
    pose: Array,
    velocity: Array,
    dts: Array,
    load: Load,
    row_of_step: IntArray,
    J: Array,
    memory: Array | None = None,
    table: Array | None = None,
    ahead: float | None = None,
) -> Steps:
    """Simulates T steps.

    Args:
        bodies: one object, with its parameters and physics.
        pose: (3,) q at the beginning, m and rad.
        velocity: (3,) of B's origin, m/s, and yaw rate, rad/s, at the beginning.
        dts: (T,) steps, s, or as `push.measure_steps` has them; the velocities are by the same.
        load: what drives the body.
        row_of_step: (T+1,) row of J that records this step, -1 for none.
        J: (rows, 3, width) filled, see `forward_sensitivity`; without columns where no derivative
            is wanted.
        memory: (MEMORY_SIZE,) of the step before, updated in place; a body that was at rest by
            default.
        table: (K, 4) edges of the table's top, m, see `Support`; without any it is endless.
        ahead: fraction of a step after which it looks at the body; as the friction law does it by
            default.

    Returns:
        The record.
    """
    record = make_record(len(dts))
    prepared = prepare_rollout(bodies, table, ahead)
    if memory is None:
        memory = make_memory()
    rollout(
        *prepared,
        load=load,
        pose=pose,
        velocity=velocity,
        dts=dts,
        row_of_step=row_of_step,
        record=record,
        J=J,
        memory=memory,
    )
    return record


def run_pushes(
    bodies: Bodies,
    *,
    pushes: Pushes,
    row_of_step: IntArray,
    J: Array,
    rows: int,
    table: Array | None = None,
    approximate: bool = False,
) -> tuple[Array, NDArray[np.bool_]]:
    """Simulates P pushes of one object in one call.

    The arguments are those of `run_kernel`, `rollout_pushes` and `prepare_rollout`.

    Returns:
        The poses (rows, 3) that are recorded, and whether the object was touched (P,).
    """
    poses = np.empty((rows, 3))
    touched = np.empty(len(pushes.radii), np.bool_)
    prepared = prepare_rollout(bodies, table, approximate=approximate)
    rollout_pushes(*prepared, pushes, row_of_step, poses, touched, J)
    return poses, touched


def run_models(
    obj: GridObject,
    models: Sequence[CellParameters],
    physics: Physics,
    *,
    pose: Array,
    dts: Array,
    load: Load,
    table: Array | None = None,
    approximate: bool = False,
) -> tuple[Array, NDArray[np.bool_]]:
    """Simulates T steps with each of M models, of an object that is at rest before them.

    The arguments are those of `run_kernel` and `prepare_rollout`.

    Returns:
        The poses (M, T+1, 3), m and rad, and whether the object tips in each step, (M, T).
    """
    count = len(dts)
    poses = np.empty((len(models), count + 1, 3))
    tips = np.empty((len(models), count), np.bool_)
    record = make_record(count)
    row_of_step = np.full(count + 1, -1)
    for m, params in enumerate(models):
        rollout(
            *prepare_rollout(Bodies(obj, params, physics), table, approximate=approximate),
            load=load,
            pose=pose,
            velocity=np.zeros(3),
            dts=dts,
            row_of_step=row_of_step,
            record=record,
            J=np.empty((0, 3, 0)),
            memory=make_memory(),
        )
        poses[m] = record.poses
        tips[m] = record.tips
    return poses, tips


def prepare_rollout(
    bodies: Bodies,
    table: Array | None,
    ahead: float | None = None,
    approximate: bool = False,
) -> tuple[Any, Body, Support, Edges, Scheme]:
    """Makes the rollout's first arguments: law, body, support, outline and scheme.

    Args:
        approximate: whether poses may be off by as much as `PushBatch` says, which takes less time.

    The other arguments are those of `run_kernel`.
    """
    obj = bodies.obj
    physics = bodies.physics
    outline = _get_outline(obj)
    body = _make_body(bodies, outline.cells)
    support = make_support(bodies, table)
    # Where loads shift, the rollout writes the law's k at every step; the body's must stay.
    k = body.k.copy() if support.active else body.k
    law = physics.law.make(k, calc_spin_lever_arm(obj, bodies.params), physics.used_spin)
    # Loads that shift would have to be brought to the nodes at every step.
    if approximate and isinstance(law, Isotropic) and obj.n >= POOLED_FROM and not support.active:
        law = law._replace(pool=CellPooling.of_object(obj).make_pool(k))
    scheme = Scheme(
        inertial=physics.inertial,
        ahead=physics.ahead if ahead is None else ahead,
        stiction=float(physics.stiction_tolerance),
        relative_stiction=float(physics.relative_stiction_tolerance),
        early_end=EARLY_END if approximate else 0.0,
    )
    return law, body, support, outline.edges, scheme


def _make_body(bodies: Bodies, cells: Array) -> Body:
    """Collects what the kernels know of the object.

    All numbers are floats: for integers Numba would compile the kernels once more. Mass, center of
    mass and inertia stay zero in the quasi-static regime.
    """
    obj = bodies.obj
    params = bodies.params
    physics = bodies.physics
    mass = 0.0
    com_x = 0.0
    com_y = 0.0
    inertia = 0.0
    if physics.inertial:
        com_x, com_y = map(float, params.center_of_mass(obj))
        mass = float(params.total_mass)
        inertia = float(params.inertia(obj))
    return Body(
        cells=cells,
        k=params.friction * params.mass * physics.gravity,
        mass=mass,
        com_x=com_x,
        com_y=com_y,
        inertia=inertia,
        gyration_radius=float(obj.radius_of_gyration),
        cell_size=float(obj.cell_size),
        contact_friction=float(params.contact_friction),
    )


def shifts_loads(params: CellParameters, table: Array | None) -> bool:
    """Whether loads shift at all: by the pusher's height, or over the table's edge."""
    return params.push_height > 0 or table is not None


def make_support(bodies: Bodies, table: Array | None) -> Support:
    """Collects what the loads depend on; `table` as in `run_kernel`."""
    obj = bodies.obj
    params = bodies.params
    if not shifts_loads(params, table):
        return NO_SUPPORT
    com_x, com_y = map(float, params.center_of_mass(obj))
    lines = _get_lines(obj)
    return Support(
        active=True,
        mass=params.mass.copy(),
        friction=params.friction.copy(),
        weight=params.total_mass * bodies.physics.gravity,
        com_x=com_x,
        com_y=com_y,
        height=params.push_height,
        reach=lines.reach,
        xs=lines.xs,
        ys=lines.ys,
        column=lines.column,
        row=lines.row,
        table=np.empty((0, 4)) if table is None else table,
    )


NO_SUPPORT = Support(
    active=False,
    mass=np.empty(0),
    friction=np.empty(0),
    weight=0.0,
    com_x=0.0,
    com_y=0.0,
    height=0.0,
    reach=0.0,
    xs=np.empty(0),
    ys=np.empty(0),
    column=np.empty(0, np.int64),
    row=np.empty(0, np.int64),
    table=np.empty((0, 4)),
)
"""What the kernels are given where every cell bears its own weight."""


def find_rest_loads(bodies: Bodies, pose: Array, table: Array | None) -> Array | None:
    """Calculates the loads (n,), N, of a body at rest at a pose (3,); None where there are none.

    `table` as in `run_kernel`.
    """
    obj = bodies.obj
    params = bodies.params
    support = make_support(bodies, np.empty((0, 4)) if table is None else table)
    loads = make_loads(support)
    at_rest = make_state(pose, np.zeros(3), 0.0, 0.0)
    cells = _get_outline(obj).cells
    friction = np.empty(obj.n)  # filled with k, which is not wanted here
    held = find_loads(support, cells, float(obj.cell_size), at_rest, loads, friction)
    weight = params.total_mass * bodies.physics.gravity
    return weight * params.mass * loads.fraction if held else None


def calc_reach(obj: GridObject) -> float:
    """The farthest cell's distance from B's origin, m."""
    return _get_lines(obj).reach


def get_cells(obj: GridObject) -> Array:
    """The cells' centers (2, n), m, in the array that all kernels share; not to be changed."""
    return _get_outline(obj).cells


class _CellLines(NamedTuple):
    """The lines along which an object's cells stand.

    Attributes:
        reach: of the cells' centers from B's origin, m.
        xs, ys: the x and the y that occur among the cells, m.
        column, row: (n,) which of them are each cell's.
    """

    reach: float
    xs: Array
    ys: Array
    column: IntArray
    row: IntArray


class _Outline(NamedTuple):
    """The cells' centers (2, n), m, and the outline, in the arrays that the kernels take."""

    cells: Array
    edges: Edges


def _get_lines(obj: GridObject) -> _CellLines:
    """Finds the lines of an object's cells, once for each object."""
    cached: _CellLines | None = obj.__dict__.get("_kernel_lines")
    if cached is None:
        reach = float(np.linalg.norm(obj.p_BC, axis=1).max())
        xs, column = np.unique(obj.p_BC[:, 0], return_inverse=True)
        ys, row = np.unique(obj.p_BC[:, 1], return_inverse=True)
        cached = _CellLines(reach, xs, ys, column, row)
        obj.__dict__["_kernel_lines"] = cached
    return cached


def _get_outline(obj: GridObject) -> _Outline:
    """Makes an object's cells and outline as the kernels want them, once for each object.

    They are writable copies: for arrays that are not, Numba would compile the kernels once more.
    """
    cached: _Outline | None = obj.__dict__.get("_kernel_arrays")
    if cached is None:
        edges = obj.edges
        ends = np.array(np.column_stack([edges.start, edges.end]).T, order="C")
        cached = _Outline(
            cells=np.array(obj.p_BC.T, order="C"),
            edges=Edges(ends[0], ends[1], ends[2], ends[3], np.array(edges.previous)),
        )
        obj.__dict__["_kernel_arrays"] = cached
    return cached
