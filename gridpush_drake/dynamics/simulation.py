"""`simulate` and `simulate_batch`: the grid object under a push; and one step by itself.

A `Physics` says how objects slide, a `Push` how the pusher moves, and a `Motion` what happened. If
the same pushes are to be simulated many times with different parameters, as in learning,
`push_batch` is faster. The model is written out in `docs/theory/model.md`.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from os import cpu_count
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from gridpush_drake.dynamics.bodies import Bodies
from gridpush_drake.dynamics.kernel_call import (
    calc_reach,
    find_rest_loads,
    run_kernel,
    shifts_loads,
)
from gridpush_drake.dynamics.kernels.forward_sensitivity import OTHER_COLUMNS
from gridpush_drake.dynamics.kernels.inputs import Load, Steps
from gridpush_drake.dynamics.kernels.step import STEP_CONVERGED
from gridpush_drake.dynamics.kernels.support_loads import measure_depth
from gridpush_drake.dynamics.motion import (
    OVERLAP_TOLERANCE,
    Jacobian,
    Motion,
    MotionStatus,
    RawJacobian,
)
from gridpush_drake.dynamics.one_object import refuse_several
from gridpush_drake.dynamics.physics import (
    Physics,
    Regime,
    check_word,
)
from gridpush_drake.dynamics.push import (
    ForcePush,
    Push,
    check_record,
    check_times,
    make_times,
    measure_steps,
)
from gridpush_drake.dynamics.reference.paper_rollout import calc_paper_jacobian
from gridpush_drake.dynamics.scene.cores import check_overlap
from gridpush_drake.dynamics.scene.simulation import (
    count_load_columns,
    simulate_one,
    simulate_together,
)
from gridpush_drake.errors import SimulationError
from gridpush_drake.geometry.se2 import Array, IntArray, check_vector, rotate
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters

MOVED_MOST = 2.0
"""How far B's origin may go in a slow push, as a multiple of the pusher's path."""

GRADIENT_CHOICES = (False, True, "mass", "push", "paper")
"""What `simulate` may be asked to differentiate."""

EXACT_GRADIENTS = (True, "mass", "push")
"""Those of `GRADIENT_CHOICES` that ask for columns of the exact Jacobian."""


class PushSteps(NamedTuple):
    """The T steps of a push.

    Attributes:
        times: (T+1,) the steps' times, s from the push's beginning.
        dts: (T,) steps, as `push.measure_steps` has them.
        rows: (R,) the poses among the T+1 whose Jacobian is wanted.
        row_of_step: (T+1,) their places in `rows`, -1 for none.
    """

    times: Array
    dts: Array
    rows: IntArray
    row_of_step: IntArray

    @classmethod
    def of_record(
        cls, push: Push | ForcePush, times: Array, rows: IntArray, regime: str
    ) -> "PushSteps":
        """Measures the steps of a push between times (T+1,), s."""
        row_of_step = np.full(len(times), -1)
        row_of_step[rows] = np.arange(len(rows))
        return cls(times, measure_steps(push, times, regime), rows, row_of_step)

    def take_first(self, count: int) -> "PushSteps":
        """The first steps, with the Jacobian of the last of their poses."""
        row_of_step = np.full(count + 1, -1)
        row_of_step[count] = 0
        return PushSteps(
            times=self.times[: count + 1],
            dts=self.dts[:count],
            rows=np.array([count]),
            row_of_step=row_of_step,
        )


def simulate(
    bodies: Bodies,
    push: Push | ForcePush,
    pose: ArrayLike = (0.0, 0.0, 0.0),
    dt: float | None = None,
    gradients: bool | Literal["mass", "push", "paper"] = False,
    *,
    regime: Regime | None = None,
    velocity: ArrayLike = (0.0, 0.0, 0.0),
    times: ArrayLike | None = None,
    record: ArrayLike | None = None,
    table: ArrayLike | None = None,
) -> Motion:
    """Simulates one push of a grid object, or of several that push each other.

    The model is in `docs/theory/model.md`: of one object in sections 3 to 6 and 8, of several in
    section 9. What holds for one object alone is refused (`one_object`): the inertial regime (so
    pushes by a force and a `velocity`), loads that shift (a `push_height`, a `table`), and parts of
    the Jacobian by themselves.

    A step is implicit in the velocities. It sees contact and directions as they are expected
    halfway through it (the midpoint rule), except with lagged friction, which as in the paper's LCP
    takes them where the step begins.

    Args:
        bodies: one or several objects, with their parameters and physics: friction law, regime,
            spin, gravity and tolerances.
        push: the pusher's motion, or a force applied to the object.
        pose: (3,) q = (x, y, theta) of B in W at the beginning, m and rad; (N, 3) of several
            objects.
        dt: step, s; the last one is shortened to end with the push. By default so short that the
            pusher moves at most `DEFAULT_TIP_STEP` a step and, in the inertial regime, at most
            `DEFAULT_DT`.
        gradients: True adds the exact Jacobian of every recorded pose; "mass" leaves out the cells'
            frictions, which is quicker where loads shift; "push" leaves out all that is by cells,
            which is quicker where they do not; "paper" the paper's closed form, of each step by
            itself.
        regime: takes the place of the one in the physics. "auto", the default, is "inertial" where
            the push is fast (see `physics.FAST_PUSH`), is a force or has a `velocity` before it,
            and for the paper's gradient; "quasi_static" otherwise.
        velocity: (3,) (vx, vy, w) of B's origin in W at the beginning; inertial regime only.
        times: (T+1,) the steps' times, s from the push's beginning, instead of `dt`.
        record: indices into the T+1 poses whose Jacobian is wanted, negative ones from the end; all
            by default.
        table: (K, 2) corners in W of the table's top, such as `SupportSurface.corners`, m: cells
            beyond its edge bear nothing, and the others more. Endless by default. With it, or where
            `params.push_height` is not zero, loads shift (`docs/theory/model.md`, section 8).

    Returns:
        The motion. Its `status` says whether the pusher touched and every step was solved.

    Raises:
        SimulationError: an argument is out of range, or the combination makes no sense; the object
            is not on the table, or two objects overlap.
    """
    _check_kinds(bodies, push)
    check_word("gradients", gradients, GRADIENT_CHOICES)
    if len(bodies) > 1:
        poses = _check_several(bodies, push, pose, gradients, velocity, table)
        assert isinstance(push, Push)
        physics = bodies.physics.with_regime(regime)
        return simulate_together(
            bodies.with_physics(physics), push, poses, dt, bool(gradients), times, record
        )
    q = check_vector(SimulationError, "pose", pose, 3)
    nu = check_vector(SimulationError, "velocity", velocity, 3)
    if isinstance(push, Push) and push.shape is not None:
        for name, asked in (
            ("velocity", nu.any()),
            ("gradients", gradients not in (False, True)),
        ):
            if asked:
                raise SimulationError(f"{name}: is for a pusher that is one disc; expected none")
        bodies = bodies.with_physics(bodies.physics.with_regime(regime))
        edges = find_edges_near(bodies.obj, push, q, table, inertial=False)
        return simulate_one(
            bodies,
            push,
            q,
            dt=dt,
            gradients=bool(gradients),
            times=times,
            record=record,
            edges=edges,
        )
    needs_inertia = bool(nu.any()) or gradients == "paper"
    if regime is not None:
        bodies = bodies.with_physics(bodies.physics.with_regime(regime))
    bodies = _resolve(bodies, push, needs_inertia)
    used = bodies.physics
    _check_combination(bodies, push, nu, gradients)

    # When the steps end, and which of their poses are differentiated.
    times = (
        make_times(push, dt, used.regime) if times is None else check_times(times, used.inertial)
    )
    count = len(times) - 1
    rows = np.arange(count + 1) if record is None else check_record(record, count)

    return simulate_steps(
        bodies,
        push,
        pose=q,
        velocity=nu,
        steps=PushSteps.of_record(push, times, rows, used.regime),
        gradients=gradients,
        edges=find_edges_near(bodies.obj, push, q, table, used.inertial),
    )


def _check_kinds(bodies: object, push: object) -> None:
    """Raises SimulationError where arguments are of other classes, such as swapped ones."""
    expected: tuple[tuple[str, object, tuple[type, ...]], ...] = (
        ("model", bodies, (Bodies,)),
        ("push", push, (Push, ForcePush)),
    )
    for name, value, kinds in expected:
        if not isinstance(value, kinds):
            words = " or ".join(kind.__name__ for kind in kinds)
            raise SimulationError(
                f"{name}: is a {type(value).__name__}; expected a {words}, as in "
                "simulate(Model(obj, params), push)"
            )


def _check_several(
    bodies: Bodies,
    push: Push | ForcePush,
    pose: ArrayLike,
    gradients: bool | str,
    velocity: ArrayLike,
    table: ArrayLike | None,
) -> Array:
    """Refuses what is for one object alone, but for what their physics says; see `simulate`.

    Returns:
        (N, 3) the poses.
    """
    n = len(bodies)
    refuse_several(SimulationError, "push by a force", isinstance(push, ForcePush))
    refuse_several(SimulationError, "velocity", np.any(velocity))
    refuse_several(SimulationError, "table", table is not None)
    refuse_several(SimulationError, "gradients", gradients not in (False, True))
    poses = np.array(pose, dtype=np.float64)
    if poses.shape != (n, 3) or not np.isfinite(poses).all():
        raise SimulationError(
            f"pose of shape {poses.shape}; expected ({n}, 3) finite numbers, a pose of each object"
        )
    check_overlap(bodies.objects, poses)
    return poses


def simulate_steps(
    bodies: Bodies,
    push: Push | ForcePush,
    *,
    pose: Array,
    velocity: Array,
    steps: PushSteps,
    gradients: bool | Literal["mass", "push", "paper"] = False,
    edges: Array | None = None,
) -> Motion:
    """Simulates a push whose steps are known; `simulate` says more, and checks what it is given.

    Args:
        bodies: one object, with its parameters and physics, whose regime is not "auto".
        push: the pusher's motion, or a force.
        pose: (3,) q at the beginning, m and rad.
        velocity: (3,) of B's origin, m/s and rad/s.
        steps: the steps.
        gradients: as of `simulate`.
        edges: (K, 4) edges of the table, m; None where it is endless, or far.

    Raises:
        SimulationError: the paper's gradient is asked for where loads shift.
    """
    times, dts, rows, row_of_step = steps
    physics = bodies.physics
    # Room for the derivatives, whose columns depend on whether loads shift.
    shifted = shifts_loads(bodies.params, edges)
    if shifted and gradients == "paper":
        raise SimulationError(
            "gradients: 'paper' knows no shifting loads; expected a push_height of 0 and no table"
        )
    J = np.empty((0, 3, 0))
    if gradients in EXACT_GRADIENTS:
        by_cells = shifted or gradients != "push"
        width = count_columns(
            bodies.obj.n if by_cells else 0, shifted, with_friction=gradients is True
        )
        J = np.empty((len(rows), 3, width))

    load = _make_load(push, times)
    result = run_kernel(
        bodies,
        pose=pose,
        velocity=velocity,
        dts=dts,
        load=load,
        row_of_step=row_of_step,
        J=J,
        table=edges,
    )
    if not physics.inertial:
        # The kernel's velocities are by the pusher's path; they are wanted by time.
        result.velocities[1:] *= (dts / np.diff(times))[:, None]

    jacobian: Jacobian | RawJacobian | None = None
    if gradients in EXACT_GRADIENTS:
        jacobian = RawJacobian.of_parameters(
            bodies,
            steps=rows,
            J=J,
            shifted=shifted,
            start_tangent=push.start_tangent if isinstance(push, Push) else None,
            by_cells=gradients != "push",
        )
    elif gradients == "paper":
        jacobian = calc_paper_jacobian(bodies, result, dts, rows)
    has_pusher = load.radius > 0
    return Motion(
        times=times,
        poses=result.poses,
        velocities=result.velocities,
        tip=load.tip if has_pusher else np.full_like(load.tip, np.nan),
        contact_forces=result.contact_forces,
        contact_points=result.contact_points,
        modes=result.modes,
        gaps=result.gaps,
        status=_find_status(has_pusher, result),
        load_centers=result.load_centers,
        tips=result.tips,
        iterations=result.statuses[:, 1],
        physics=physics,
        _jacobian=jacobian,
    )


def count_columns(n: int, shifted: bool, with_friction: bool) -> int:
    """Counts the kernel's columns of derivatives, see `kernels.forward_sensitivity`.

    Args:
        n: cells.
        shifted: whether loads shift; there is then a column for the push height.
        with_friction: whether the cells' frictions are wanted beside their masses. Where no loads
            shift, both follow from the same columns.
    """
    return n + OTHER_COLUMNS + (count_load_columns(n, with_friction) if shifted else 0)


def calc_loads(
    bodies: Bodies,
    pose: ArrayLike = (0.0, 0.0, 0.0),
    table: ArrayLike | None = None,
) -> Array | None:
    """Calculates what the cells of an object at rest bear, (n,) N; None if it tips.

    `docs/theory/model.md`, section 8.

    The table's top is endless, or has corners (K, 2) in W, m. The loads' center is the center of
    mass. Raises SimulationError: an argument is out of range.
    """
    edges = None if table is None else get_edges(table)
    return find_rest_loads(bodies, check_vector(SimulationError, "pose", pose, 3), edges)


def simulate_batch(
    bodies: Bodies | Sequence[Bodies],
    pushes: Push | ForcePush | Sequence[Push | ForcePush],
    poses: ArrayLike = (0.0, 0.0, 0.0),
    *,
    workers: int | None = None,
    **options: Any,
) -> list[Motion]:
    """Simulates many pushes, or one push of many models, or pairs of both, on all cores.

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
    lengths = [len(value) for value in (bodies, pushes) if isinstance(value, Sequence)]
    lengths += [len(starts)] if starts.ndim == 2 else []
    count = max(lengths, default=1)
    if any(length != count for length in lengths):
        raise SimulationError(
            f"bodies, pushes and poses of lengths {lengths}; expected equal lengths, or one for all"
        )
    jobs = [
        (
            bodies[i] if isinstance(bodies, Sequence) else bodies,
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
    """Finds the edges (K, 4), m, of a table with corners (K, 2) in W that a push may reach.

    None if there is no table, or the push cannot bring the object to its edge.

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
        and inside > obj.cell_size + MOVED_MOST * _calc_farthest_way(push)
    ):
        return None  # so slow a push cannot bring the object to the edge
    return edges


def _calc_farthest_way(push: Push) -> float:
    """How far any point of the pusher may go, m; a shape that turns goes farther than its frame."""
    if push.shape is None or push.yaw is None:
        return push.length
    return push.length + push.shape.reach * float(np.abs(np.diff(push.yaw)).sum())


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
        return Load(
            tip=np.zeros((steps + 1, 2)),
            path_length=0.0,
            radius=-1.0,
            wrench=np.pad(push.force_during(times), ((0, 0), (0, 1))),
            point=np.array(push.point),
        )
    return Load(
        tip=push.tip_at(times),
        path_length=push.length,
        radius=push.radius,
        wrench=np.zeros((steps, 3)),
        point=np.zeros(2),
    )


def _find_status(has_pusher: bool, steps: Steps) -> MotionStatus:
    if (steps.statuses[:, 0] != STEP_CONVERGED).any():
        return MotionStatus.NOT_CONVERGED
    if steps.tips.any():
        return MotionStatus.TIPS
    if has_pusher and not steps.modes.any():
        return MotionStatus.NO_CONTACT
    if steps.gaps[0] < -OVERLAP_TOLERANCE:
        return MotionStatus.STARTED_OVERLAPPING
    return MotionStatus.OK


def _resolve(bodies: Bodies, push: Push | ForcePush, needs_inertia: bool) -> Bodies:
    """Replaces the regime "auto" by the one that suits a push."""
    if bodies.physics.regime != "auto":
        return bodies
    if needs_inertia or isinstance(push, ForcePush):
        return bodies.with_physics(replace(bodies.physics, regime="inertial"))
    return bodies.resolve(push.length / push.duration)


def _check_combination(
    bodies: Bodies,
    push: Push | ForcePush,
    nu: Array,
    gradients: bool | str,
) -> None:
    """Refuses combinations that make no sense, with a SimulationError."""
    physics = bodies.physics
    if not physics.inertial:
        if isinstance(push, ForcePush):
            raise SimulationError(
                "regime: a force-driven push needs 'inertial'; "
                "a quasi-static body has no velocity of its own"
            )
        if gradients == "paper":
            raise SimulationError(
                "gradients: 'paper' differentiates momentum; it needs the inertial regime"
            )
        if nu.any():
            raise SimulationError("velocity: the quasi-static regime has none; expected (0, 0, 0)")
        check_friction(physics, bodies.params)
    physics.check_gradients(True if gradients in EXACT_GRADIENTS else gradients, gradients)


def check_friction(physics: Physics, params: CellParameters) -> None:
    """Raises SimulationError where nothing has inertia and nothing rubs on the table."""
    if not physics.inertial and params.friction @ params.mass * physics.gravity <= 0:
        raise SimulationError(
            "friction: the quasi-static regime needs some friction with the support"
        )


STEP_STICTION = 1e-10
"""Stiction tolerance of `calc_step`, m/s, and as a fraction of the speed: what sticks moves less
than a few of these."""


def calc_step(
    bodies: Bodies,
    q: ArrayLike,
    nu: ArrayLike,
    wrench: ArrayLike,
    dt: float,
    *,
    stiction_tolerance: float = STEP_STICTION,
) -> Array:
    """Takes one condensed inertial step at a fixed pose (`docs/theory/model.md`, section 3).

    Args:
        bodies: one object, with its parameters and physics.
        q: (3,) pose X_WB, m and rad; directions and arms are those at this pose, as in the paper's
            LCP.
        nu: (3,) velocity of B's origin in W, m/s, and yaw rate, rad/s.
        wrench: (3,) force in W, N, and moment about B's origin, N m.
        dt: the step, s.
        stiction_tolerance: takes the place of both tolerances in `physics`, m/s and as a fraction
            of the speed.

    Returns:
        nu' (3,) at the end of the step, before the pose moves.

    Raises:
        SimulationError: dt or the tolerance is not positive, the regime is "quasi_static", or the
            step was not solved.
    """
    obj = bodies.obj
    physics = bodies.physics
    if not 0 < dt < np.inf:
        raise SimulationError(f"dt is {dt!r}; expected a positive number (s)")
    if physics.regime == "quasi_static":
        raise SimulationError("regime is 'quasi_static'; expected 'inertial', as the step is")
    used = replace(
        physics,
        regime="inertial",
        stiction_tolerance=stiction_tolerance,
        relative_stiction_tolerance=stiction_tolerance,
    )
    q = np.array(q, dtype=np.float64)
    # Without a pusher, and seen at the pose where it begins.
    load = Load(
        tip=np.zeros((2, 2)),
        path_length=0.0,
        radius=-1.0,
        wrench=np.array([wrench], dtype=np.float64),
        point=np.zeros(2),
    )
    record = run_kernel(
        bodies.with_physics(used),
        pose=q,
        velocity=np.array(nu, dtype=np.float64),
        dts=np.array([float(dt)]),
        load=load,
        row_of_step=np.full(2, -1),
        J=np.empty((0, 3, 0)),
        ahead=0.0,
    )
    if record.statuses[0, 0] != STEP_CONVERGED:
        raise SimulationError(f"the step of {obj.name} ({obj.n} cells) was not solved")
    return np.append(rotate(q[2], record.twists[0, :2]), record.twists[0, 2])
