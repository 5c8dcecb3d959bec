"""`simulate_together`: several grid objects under a push, which push each other.

The model is that of one object with contacts between bodies, in the quasi-static regime
(`docs/theory/model.md`, section 9). For one object it gives the motion that `simulate` gives, by
which it is tested; `simulate` calls it where there are more.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from gridpush_drake.dynamics.bodies import Bodies, describe_object
from gridpush_drake.dynamics.kernel_call import NO_SUPPORT, make_support
from gridpush_drake.dynamics.kernels.scene.records import SceneSteps
from gridpush_drake.dynamics.kernels.scene.step_derivative import PUSH_COLUMNS
from gridpush_drake.dynamics.kernels.step import STEP_CONVERGED
from gridpush_drake.dynamics.motion import (
    NO_BODY,
    OVERLAP_TOLERANCE,
    Jacobian,
    Motion,
    MotionStatus,
)
from gridpush_drake.dynamics.one_object import refuse_several
from gridpush_drake.dynamics.push import (
    Push,
    check_record,
    check_times,
    make_times,
    measure_steps,
)
from gridpush_drake.dynamics.scene.kernel_call import (
    CENTER_X,
    CENTER_Y,
    PATH_VARIATIONS,
    TURN,
    YAW,
    make_bodies,
    make_pusher_path,
    make_scene_contacts,
    make_scene_state,
    run_scene_kernel,
)
from gridpush_drake.errors import SimulationError
from gridpush_drake.geometry.se2 import Array, IntArray, rotate
from gridpush_drake.objects.parameters import CellParameters


def simulate_together(
    bodies: Bodies,
    push: Push,
    poses: Array,
    dt: float | None = None,
    gradients: bool = False,
    times: ArrayLike | None = None,
    record: ArrayLike | None = None,
    edges: Array | None = None,
) -> Motion:
    """Simulates one push of several objects, quasi-statically.

    Args:
        bodies: the objects; the regime "auto" is "quasi_static" here.
        push: the pusher's motion.
        poses: (N, 3) of the objects at the beginning, m and rad. They may overlap, as poses that
            were seen with noise do; in the push the objects are moved apart little by little.
        dt: as of `simulate`, as all that follows.
        gradients: whether the exact Jacobian of every recorded pose is added.
        times: (T+1,) the steps' times, s.
        record: indices of the poses whose Jacobian is wanted.
        edges: (K, 4) edges of the table, m, for one object alone; None where it is endless, or far.

    Returns:
        The motion; its arrays have an axis for the objects, even where there is one.

    Raises:
        SimulationError: an argument is out of range, or asks for something that is for one object
            alone.
    """
    bodies = check_together(bodies) if len(bodies) > 1 else check_shaped_push(bodies)
    used = bodies.physics
    used.check_gradients(gradients, gradients)
    n = len(bodies)
    # When the steps end, and which of their poses are differentiated.
    times = make_times(push, dt, used.regime) if times is None else check_times(times, False)
    dts = measure_steps(push, times, used.regime)
    steps = len(dts)
    rows = np.arange(steps + 1) if record is None else check_record(record, steps)
    row_of_step = np.full(steps + 1, -1)
    row_of_step[rows] = np.arange(len(rows))
    J = np.empty((0, n, 3, 0))
    # Loads shift at an edge and where the push is high, of one object alone.
    support = make_support(bodies, edges) if n == 1 else NO_SUPPORT
    shifted = support.active
    varied = push.shape is not None
    if gradients:
        width = count_scene_columns(bodies, varied, shifted=shifted, with_friction=shifted)
        J = np.empty((len(rows), n, 3, width))

    # The kernel, from rest.
    path = make_pusher_path(push, times, gradients)
    contacts = make_scene_contacts(n, path.tool)
    result = run_scene_kernel(
        make_bodies(bodies),
        used,
        pusher=path,
        state=make_scene_state(poses),
        contacts=contacts,
        dts=dts,
        row_of_step=row_of_step,
        J=J,
        support=support,
    )
    # Rows beyond a step's contacts tell nothing; as many are kept as the step with most has.
    room = int(result.counts.max(initial=0))
    beyond = np.arange(room) >= result.counts[:, None]
    pairs = result.ids[:, :room, :2].copy()
    pairs[beyond] = NO_BODY
    points = result.points[:, :room]
    points[beyond] = np.nan
    return Motion(
        times=times,
        poses=result.poses,
        velocities=_calc_velocities(result, dts / np.diff(times)),
        tip=path.tip,
        contact_forces=result.forces[:, :room],
        contact_points=points,
        modes=result.modes[:, :room],
        gaps=result.finger_gaps,
        status=_find_status(result, int(contacts.lost[0])),
        load_centers=np.repeat(result.load_centers[:, None], n, axis=1),
        tips=np.repeat(result.tips[:, None], n, axis=1),
        iterations=result.statuses[:, 1],
        physics=used,
        contact_bodies=pairs,
        contact_gaps=result.gaps[:, :room],
        residuals=result.residuals,
        yaw=None if push.yaw is None else path.yaw,
        _jacobian=expand_columns(bodies, J, rows, varied, shifted) if gradients else None,
    )


def simulate_one(
    bodies: Bodies,
    push: Push,
    pose: Array,
    dt: float | None = None,
    gradients: bool = False,
    times: ArrayLike | None = None,
    record: ArrayLike | None = None,
    edges: Array | None = None,
) -> Motion:
    """Simulates one push of one object by a pusher of any shape, quasi-statically.

    The arguments, and errors, are those of `simulate_together`.

    Returns:
        The motion, as that of one object under a disc, but with room for more contacts.
    """
    # as one of several, and then without the axis of the objects
    motion = simulate_together(
        bodies,
        push,
        pose[None],
        dt=dt,
        gradients=gradients,
        times=times,
        record=record,
        edges=edges,
    )
    jacobian = None
    if isinstance(motion._jacobian, Jacobian):
        blocks = vars(motion._jacobian)
        one = {
            name: block[:, 0]
            for name, block in blocks.items()
            if isinstance(block, np.ndarray) and name != "steps"
        }
        one["contact_friction"] = one["contact_friction"][..., 0]
        one["pose"] = one["pose"][..., 0, :]
        jacobian = Jacobian(**{**blocks, **one, "pair_friction": None})
    return replace(
        motion,
        poses=motion.poses[:, 0],
        velocities=motion.velocities[:, 0],
        load_centers=motion.load_centers[:, 0],
        tips=motion.tips[:, 0],
        contact_bodies=None,
        _jacobian=jacobian,
    )


def check_shaped_push(bodies: Bodies) -> Bodies:
    """Refuses what a disc alone can do to an object, and makes the regime "auto" "quasi_static".

    Raises:
        SimulationError: names what it is.
    """
    physics = bodies.physics
    if physics.regime == "inertial":
        raise SimulationError(
            "regime: 'inertial' is for a pusher that is one disc; expected 'quasi_static'"
        )
    check_table_friction(bodies.params, physics.gravity, "")
    return bodies.with_physics(physics.with_regime("quasi_static"))


def check_table_friction(params: CellParameters, gravity: float, name: str) -> None:
    """Raises SimulationError where an object of that name has no friction with the support."""
    if params.friction @ params.mass * gravity <= 0:
        raise SimulationError(
            f"{name}friction is zero; the quasi-static regime needs some friction with the support"
        )


def check_together(bodies: Bodies) -> Bodies:
    """Refuses what is for one object alone, and makes the regime "auto" "quasi_static".

    Raises:
        SimulationError: names what it is; or an object has no friction with the support, or the
            friction law does not know slow pushes.
    """
    physics = bodies.physics
    refuse_several(SimulationError, "regime", physics.regime == "inertial")
    for i, params in enumerate(bodies.parameters):
        name = describe_object(bodies.objects, i)
        asked = f"{name}: push_height"
        refuse_several(SimulationError, "push_height", params.push_height > 0, asked)
        check_table_friction(params, physics.gravity, f"{name}: ")
    return bodies.with_physics(physics.with_regime("quasi_static"))


def count_scene_columns(
    bodies: Bodies, varied: bool = False, *, shifted: bool = False, with_friction: bool = False
) -> int:
    """Counts the kernel's columns of derivatives, see `kernels.scene.step_derivative`.

    Args:
        bodies: the objects.
        varied: whether the path of the pusher is varied, see `make_pusher_path`.
        shifted: whether the loads of one object shift.
        with_friction: whether the cells' frictions are then wanted beside their masses.
    """
    by_loads = count_load_columns(bodies.obj.n, with_friction) if shifted else 0
    return place_columns(bodies, varied).loads + by_loads


class ColumnPlaces(NamedTuple):
    """Where the kernel's columns begin, see `kernels.scene.step_derivative`.

    Attributes:
        finger: those of the frictions with the pusher, after the M cells' loads.
        pair: of the frictions between objects.
        push: of the push.
        pose: of the first poses.
        loads: by the height of the push and by the cells' frictions, there where loads shift.
    """

    finger: int
    pair: int
    push: int
    pose: int
    loads: int


def place_columns(bodies: Bodies, varied: bool) -> ColumnPlaces:
    """Finds where the kernel's columns begin; the arguments are those of `count_scene_columns`."""
    # the cells' loads come first, then each kind of friction
    n = len(bodies)
    cells = sum(obj.n for obj in bodies.objects)
    pair = cells + n
    push = pair + n * (n - 1) // 2
    pose = push + PUSH_COLUMNS + (PATH_VARIATIONS if varied else 0)
    return ColumnPlaces(finger=cells, pair=pair, push=push, pose=pose, loads=pose + 3 * n)


def count_load_columns(n: int, with_friction: bool) -> int:
    """Counts the last columns of one object of n cells whose loads shift."""
    return 1 + (n if with_friction else 0)


def expand_columns(
    bodies: Bodies, J: Array, rows: IntArray, varied: bool, shifted: bool
) -> Jacobian:
    """Makes named blocks of the kernel's columns J (R, N, 3, width), by k_i = mu_i m_i g.

    Where loads shift, the columns are by masses and frictions already. The other arguments are
    those of `count_scene_columns`.
    """
    # the columns, in the kernel's order
    n = len(bodies)
    at = place_columns(bodies, varied)
    load = J[..., : at.finger]
    variations = J[..., at.push + PUSH_COLUMNS : at.pose]
    by_pair = np.zeros((*J.shape[:3], n, n))
    if n > 1:
        # one number stands in two places of the matrix
        i, j = np.triu_indices(n, 1)
        by_pair[..., i, j] = by_pair[..., j, i] = J[..., at.pair : at.push]
    # by mass and by friction through k
    gravity = bodies.physics.gravity
    mass = np.concatenate([params.mass for params in bodies.parameters])
    friction = np.concatenate([params.friction for params in bodies.parameters])
    return Jacobian(
        steps=rows,
        mass=load if shifted else load * (friction * gravity),
        friction=J[..., at.loads + 1 :] if shifted else load * (mass * gravity),
        push_height=J[..., at.loads] if shifted else None,
        contact_friction=J[..., at.finger : at.pair],
        start=J[..., at.push : at.push + 2],
        direction=J[..., at.push + 2],
        length=J[..., at.push + 3],
        pose=J[..., at.pose : at.loads].reshape(*J.shape[:3], n, 3),
        pair_friction=by_pair,
        yaw=variations[..., YAW] if varied else None,
        turn=variations[..., TURN] if varied else None,
        center=variations[..., CENTER_X : CENTER_Y + 1] if varied else None,
    )


def _calc_velocities(result: SceneSteps, rates: Array) -> Array:
    """Calculates velocities (T+1, N, 3) in W, m/s and rad/s, of the twists by the pusher's path.

    Args:
        result: what the kernel recorded.
        rates: (T,) speed of the pusher along its path in each step, m/s.
    """
    # at rest before the push; then each in its own frame at the end of the step
    velocities = np.zeros_like(result.poses)
    twists = result.twists * rates[:, None, None]
    velocities[1:, :, :2] = rotate(result.poses[1:, :, 2], twists[..., :2])
    velocities[1:, :, 2] = twists[..., 2]
    return velocities


def _find_status(result: SceneSteps, lost: int) -> MotionStatus:
    if (result.statuses[:, 0] != STEP_CONVERGED).any() or lost > 0:
        return MotionStatus.NOT_CONVERGED
    if result.tips.any():
        return MotionStatus.TIPS
    room = int(result.counts.max(initial=0))
    with_finger = result.ids[:, :room, 1] < 0
    if not (result.modes[:, :room][with_finger] != 0).any():
        return MotionStatus.NO_CONTACT
    if result.finger_gaps[0] < -OVERLAP_TOLERANCE:
        return MotionStatus.STARTED_OVERLAPPING
    return MotionStatus.OK
