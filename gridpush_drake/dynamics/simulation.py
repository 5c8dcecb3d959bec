"""`simulate` and `simulate_batch`: the grid object under a push; and one step by itself."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from os import cpu_count
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridpush_drake.dynamics.kernels.call import (
    calc_reach,
    find_rest_loads,
    make_method,
    run_kernel,
    shifts_loads,
)
from gridpush_drake.dynamics.kernels.forward_sensitivity import OTHER
from gridpush_drake.dynamics.kernels.friction import LAWS
from gridpush_drake.dynamics.kernels.friction_law import SPIN_MODELS
from gridpush_drake.dynamics.kernels.inputs import Load, Steps
from gridpush_drake.dynamics.kernels.step import CONVERGED
from gridpush_drake.dynamics.kernels.support_loads import measure_depth
from gridpush_drake.dynamics.motion import Jacobian, Motion, MotionStatus, RawJacobian
from gridpush_drake.dynamics.push import ForcePush, Push, check_times, make_times, measure_steps
from gridpush_drake.dynamics.reference.paper_rollout import calc_paper_jacobian
from gridpush_drake.errors import SimulationError
from gridpush_drake.geometry.se2 import Array, check_vector, rotate
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters

Regime = Literal["inertial", "quasi_static"]

GRAVITY = 9.81  # m/s²
STICTION_TOLERANCE = (
    1e-9  # m/s, of the inertial regime; a body at rest creeps slower than a few of these
)
MIN_STICTION = 1e-15  # m/s; below it round-off rules
RELATIVE_STICTION = (
    1e-7  # of the speed of pusher and body; friction is never smoothed less, in either regime
)
MOVED_MOST = 2.0  # how far B's origin may go in a slow push, as a multiple of the pusher's path
OVERLAP_TOLERANCE = 1e-4  # m, of pusher and outline at the beginning


def simulate(
    obj: GridObject,
    params: CellParameters,
    push: Push | ForcePush,
    pose: ArrayLike = (0.0, 0.0, 0.0),
    dt: float | None = None,
    gradients: bool | Literal["mass", "paper"] = False,
    *,
    velocity: ArrayLike = (0.0, 0.0, 0.0),
    regime: Regime = "inertial",
    friction: str = "isotropic",
    spin: Literal["coupled", "separate", "none"] = "coupled",
    gravity: float = GRAVITY,
    times: ArrayLike | None = None,
    record: ArrayLike | None = None,
    stiction_tolerance: float = STICTION_TOLERANCE,
    table: ArrayLike | None = None,
) -> Motion:
    """Simulates one push of a grid object (`docs/theory/model.md`, sections 3-6).

    A step is implicit in the velocities. It sees contact and directions as they are expected
    halfway through it (the midpoint rule), except with lagged friction, which as in the paper's LCP
    takes them where the step begins.

    Args:
        push: the pusher's motion, or a force applied to the object.
        pose: (3,) q = (x, y, theta) of B in W at the beginning, m and rad.
        dt: step, s; the last one is shortened to end with the push. By default so short that the
            pusher moves at most `DEFAULT_TIP_STEP` a step and, in the inertial regime, at most
            `DEFAULT_DT`.
        gradients: True adds the exact Jacobian of every recorded pose; "mass" leaves out the cells'
            frictions, which is quicker where loads shift; "paper" the paper's closed form, of each
            step by itself.
        velocity: (3,) (vx, vy, w) of B's origin in W at the beginning; inertial regime only.
        regime: "inertial", or "quasi_static": the limit of slow pushes, where only the cells'
            shares of the friction matter, not the masses, nor how fast the pusher goes.
        friction: the law of support friction, one of `kernels.LAWS`: "isotropic" (implicit, exact
            at the transition from stick to slip) or "lagged", the paper's LCP, whose friction
            directions are those of the step before.
        spin: how the cells resist spinning, see `kernels.isotropic_friction`; "lagged" friction is
            always "separate".
        gravity: m/s².
        times: (T+1,) the steps' times, s from the push's beginning, instead of `dt`.
        record: indices into the T+1 poses whose Jacobian is wanted, negative ones from the end; all
            by default.
        stiction_tolerance: speed below which friction is smoothed, m/s; inertial regime only.
        table: (K, 2) corners in W of the table's top, such as `SupportSurface.corners`, m: cells
            beyond its edge bear nothing, and the others more. Endless by default. With it, or where
            `params.push_height` is not zero, loads shift (`docs/theory/model.md`, section 8).

    Returns:
        The motion. Its `status` says whether the pusher touched and every step was solved.

    Raises:
        SimulationError: an argument is out of range, or the combination makes no sense; the object
            is not on the table.
    """
    check_regime(regime, push, friction, spin, gradients)
    if params.n != obj.n:
        raise SimulationError(
            f"parameters of {params.n} cells; expected {obj.n}, as {obj.name} has"
        )
    check_number("gravity", gravity, 0.0)
    check_number("stiction_tolerance", stiction_tolerance, MIN_STICTION)
    inertial = regime == "inertial"
    q, nu = (
        check_vector(SimulationError, name, value, 3)
        for name, value in (("pose", pose), ("velocity", velocity))
    )
    if not inertial and nu.any():
        raise SimulationError("velocity: the quasi-static regime has none; expected (0, 0, 0)")
    if not inertial and params.friction @ params.mass * gravity <= 0:
        raise SimulationError(
            "friction: the quasi-static regime needs some friction with the support"
        )
    times = make_times(push, dt, regime) if times is None else check_times(times, inertial)
    steps, dts = len(times) - 1, measure_steps(push, times, regime)
    rows = np.arange(steps + 1) if record is None else check_record(record, steps)
    row_of_step = np.full(steps + 1, -1)
    row_of_step[rows] = np.arange(len(rows))
    edges = find_edges_near(obj, push, q, table, inertial)
    shifted = shifts_loads(params, edges)
    if shifted and gradients == "paper":
        raise SimulationError(
            "gradients: 'paper' knows no shifting loads; expected a push_height of 0 and no table"
        )
    width = obj.n + OTHER + (shifted and 1) + (obj.n if shifted and gradients is True else 0)
    J = np.empty((len(rows), 3, width)) if gradients in (True, "mass") else np.empty((0, 3, 0))
    method = make_method(inertial, friction, spin, stiction_tolerance, RELATIVE_STICTION)
    load = _make_load(push, times)
    result = run_kernel(obj, params, gravity, method, q, nu, dts, load, row_of_step, J, table=edges)
    if not inertial:
        result.velocities[1:] *= (dts / np.diff(times))[:, None]

    jacobian: Jacobian | RawJacobian | None = None
    if gradients in (True, "mass"):
        tangent = push.start_tangent if isinstance(push, Push) else None
        jacobian = RawJacobian(
            rows,
            J,
            obj.p_BC,
            obj.cell_size,
            params.mass,
            params.friction,
            gravity,
            inertial,
            tangent,
            shifted,
        )
    elif gradients == "paper":
        jacobian = calc_paper_jacobian(obj, params, result, dts, rows, gravity, method)
    has_pusher = load.radius > 0
    return Motion(
        times, result.poses, result.velocities, load.tip if has_pusher else np.full_like(load.tip, np.nan),
        result.contact_forces, result.contact_points, result.modes, result.gaps, _find_status(has_pusher, result),
        result.load_centers, result.tips, result.statuses[:, 1], jacobian,
    )  # fmt: skip


def calc_loads(
    obj: GridObject,
    params: CellParameters,
    pose: ArrayLike = (0.0, 0.0, 0.0),
    table: ArrayLike | None = None,
    gravity: float = GRAVITY,
) -> Array | None:
    """What the cells of an object at rest bear, (n,) N (`docs/theory/model.md`, section 8); None where it tips.

    The table's top is endless, or has corners (K, 2) in W, m. The loads' center is the center of
    mass. Raises SimulationError: an argument is out of range.
    """
    edges = None if table is None else get_edges(table)
    return find_rest_loads(
        obj, params, gravity, check_vector(SimulationError, "pose", pose, 3), edges
    )


def simulate_batch(
    obj: GridObject | Sequence[GridObject],
    params: CellParameters | Sequence[CellParameters],
    pushes: Push | ForcePush | Sequence[Push | ForcePush],
    poses: ArrayLike = (0.0, 0.0, 0.0),
    *,
    workers: int | None = None,
    **options: Any,
) -> list[Motion]:
    """Simulates many pushes, parameter sets or objects, or combinations of them, on all cores.

    Each argument is one for all, or a list; poses are (3,) or (count, 3).

    Args:
        workers: threads; by default one a core. The result does not depend on it.
        options: passed on to `simulate`.

    Raises:
        SimulationError: the lists' lengths disagree, there is no worker, or as `simulate`.
    """
    if workers is not None and not workers >= 1:
        raise SimulationError(f"workers is {workers}; expected 1 or more")
    starts = np.array(poses, dtype=np.float64)
    if starts.ndim not in (1, 2) or starts.shape[-1] != 3:
        raise SimulationError(f"poses of shape {starts.shape}; expected (3,) or (count, 3)")
    lengths = [len(value) for value in (obj, params, pushes) if isinstance(value, Sequence)]
    lengths += [len(starts)] if starts.ndim == 2 else []
    count = max(lengths, default=1)
    if any(length != count for length in lengths):
        raise SimulationError(
            f"objects, params, pushes and poses of lengths {lengths}; expected equal lengths, or one for all"
        )
    jobs = [
        (
            obj[i] if isinstance(obj, Sequence) else obj,
            params[i] if isinstance(params, Sequence) else params,
            pushes[i] if isinstance(pushes, Sequence) else pushes,
            starts[i] if starts.ndim == 2 else starts,
        )
        for i in range(count)
    ]
    if workers == 1:
        return [simulate(*job, **options) for job in jobs]
    with ThreadPoolExecutor(workers or cpu_count()) as pool:
        return list(pool.map(lambda job: simulate(*job, **options), jobs))


def find_edges_near(
    obj: GridObject, push: Push | ForcePush, q: Array, table: ArrayLike | None, inertial: bool
) -> Array | None:
    """The edges (K, 4) of a table, by its corners (K, 2) in W, that a push may bring an object to, m; None for none.

    Raises SimulationError: the corners are none, or the object is not on the table.
    """
    if table is None:
        return None
    edges = get_edges(table)
    inside = measure_depth(edges, q[0], q[1])[0] - calc_reach(obj)
    if inside < 0 and not any(measure_depth(edges, x, y)[0] > 0 for x, y in obj.cells_at(q)):
        where = ", ".join(f"{value:g}" for value in q)
        raise SimulationError(
            f"table: no cell of {obj.name} is on it at the pose ({where}); expected an object on it"
        )
    if (
        not inertial
        and isinstance(push, Push)
        and inside > obj.cell_size + MOVED_MOST * push.length
    ):
        return None  # so slow a push cannot bring the object to the edge
    return edges


def get_edges(table: ArrayLike) -> Array:
    """The edges (K, 4), (ax, ay, bx, by), of a table by its corners (K, 2), m.

    Raises SimulationError: the corners are none.
    """
    corners = np.asarray(table, dtype=np.float64)
    if (
        corners.ndim != 2
        or corners.shape[1] != 2
        or len(corners) < 3
        or not np.isfinite(corners).all()
    ):
        raise SimulationError(
            f"table: corners of shape {corners.shape}; expected (K, 2) finite numbers, K >= 3 (m)"
        )
    return np.column_stack([corners, np.roll(corners, -1, axis=0)])


def _make_load(push: Push | ForcePush, times: Array) -> Load:
    """Samples a push at the steps' times (T+1,), s."""
    steps = len(times) - 1
    if isinstance(push, ForcePush):
        wrench = np.pad(push.force_during(times), ((0, 0), (0, 1)))
        return Load(np.zeros((steps + 1, 2)), 0.0, -1.0, wrench, np.array(push.point))
    return Load(push.tip_at(times), push.length, push.radius, np.zeros((steps, 3)), np.zeros(2))


def _find_status(has_pusher: bool, steps: Steps) -> MotionStatus:
    if (steps.statuses[:, 0] != CONVERGED).any():
        return MotionStatus.NOT_CONVERGED
    if steps.tips.any():
        return MotionStatus.TIPS
    if has_pusher and not steps.modes.any():
        return MotionStatus.NO_CONTACT
    if steps.gaps[0] < -OVERLAP_TOLERANCE:
        return MotionStatus.STARTED_OVERLAPPING
    return MotionStatus.OK


def check_regime(
    regime: str, push: Push | ForcePush, friction: str, spin: str, gradients: bool | str
) -> None:
    """Refuses words that are not known, and combinations that make no sense, with a SimulationError."""
    for name, value, known in (
        ("regime", regime, ("inertial", "quasi_static")),
        ("friction", friction, tuple(LAWS)),
        ("spin", spin, SPIN_MODELS),
        ("gradients", gradients, (False, True, "mass", "paper")),
    ):
        if value not in known:
            raise SimulationError(
                f"{name} is {value!r}; expected one of {', '.join(map(repr, known))}"
            )
    quasi_static = regime == "quasi_static"
    if quasi_static and isinstance(push, ForcePush):
        raise SimulationError(
            "regime: a force-driven push needs 'inertial'; a quasi-static body has no velocity of its own"
        )
    if quasi_static and gradients == "paper":
        raise SimulationError(
            "gradients: 'paper' differentiates momentum; it needs the inertial regime"
        )
    law = LAWS[friction]
    if regime not in law.regimes:
        raise SimulationError(
            f"friction: {friction!r} needs the regime {' or '.join(map(repr, law.regimes))}"
        )
    if (gradients if gradients != "mass" else True) not in law.gradients:
        words = ", ".join(map(repr, law.gradients))
        raise SimulationError(
            f"gradients is {gradients!r}; with friction={friction!r} expected one of {words}"
        )


def check_number(name: str, value: float, least: float) -> None:
    """Raises SimulationError for what is not a finite number of at least `least`."""
    if not (np.isfinite(value) and value >= least):
        raise SimulationError(f"{name} is {value!r}; expected a finite number >= {least:g}")


def check_record(record: ArrayLike, steps: int) -> NDArray[np.int64]:
    """Copies the indices of the poses whose Jacobian is wanted, out of steps + 1; negative ones count from the end.

    Raises SimulationError where they are not whole numbers in that range that name each pose once
    at most.
    """
    rows = np.array(record)
    whole = rows.ndim == 1 and (len(rows) == 0 or np.issubdtype(rows.dtype, np.integer))
    if not whole or (rows < -(steps + 1)).any() or (rows > steps).any():
        raise SimulationError(f"record: expected whole numbers from {-(steps + 1)} to {steps}")
    rows = rows.astype(np.int64)
    rows[rows < 0] += steps + 1
    if len(np.unique(rows)) != len(rows):
        raise SimulationError("record: names a pose twice; expected distinct indices")
    return rows


STEP_STICTION = 1e-10  # m/s, and share of the speed: what sticks moves less than a few of these


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
    g: float = GRAVITY,
    stiction_tolerance: float = STEP_STICTION,
) -> NDArray[np.float64]:
    """Takes one condensed inertial step at a fixed pose (`docs/theory/model.md`, section 3).

    Args:
        q: (3,) pose X_WB, m and rad; directions and arms are those at this pose, as in the paper's
            LCP.
        nu: (3,) velocity of B's origin in W, m/s, and yaw rate, rad/s.
        wrench: (3,) force in W, N, and moment about B's origin, N m.
        friction: "isotropic", or the paper's "lagged" directions, which are "separate" whatever
            `spin` says.
        spin: how the cells resist spinning, see `kernels.isotropic_friction`.
        stiction_tolerance: speed below which friction is smoothed, m/s and as a share of the speed.

    Returns:
        nu' (3,) at the end of the step, before the pose moves.

    Raises:
        SimulationError: `friction` or `spin` is none of the words, dt is not positive, or the step
            was not solved.
    """
    if friction not in LAWS:
        raise SimulationError(
            f"friction is {friction!r}; expected one of {', '.join(map(repr, LAWS))}"
        )
    if spin not in SPIN_MODELS:
        raise SimulationError(
            f"spin is {spin!r}; expected one of {', '.join(map(repr, SPIN_MODELS))}"
        )
    if not 0 < dt < np.inf:
        raise SimulationError(f"dt is {dt!r}; expected a positive number (s)")
    method = make_method(True, friction, spin, stiction_tolerance, stiction_tolerance)._replace(
        ahead=0.0
    )
    load = Load(np.zeros((2, 2)), 0.0, -1.0, np.array([wrench], dtype=np.float64), np.zeros(2))
    q, nu = np.array(q, dtype=np.float64), np.array(nu, dtype=np.float64)
    record = run_kernel(
        obj,
        params,
        g,
        method,
        q,
        nu,
        np.array([float(dt)]),
        load,
        np.full(2, -1),
        np.empty((0, 3, 0)),
    )
    if record.statuses[0, 0] != CONVERGED:
        raise SimulationError(f"the step of {obj.name} ({obj.n} cells) was not solved")
    return np.append(rotate(q[2], record.twists[0, :2]), record.twists[0, 2])
