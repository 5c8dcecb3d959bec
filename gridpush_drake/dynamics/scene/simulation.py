"""`simulate_scene`: several grid objects under a push, which push each other.

The model is that of `simulate` with contacts between bodies, in the quasi-static regime
(`docs/theory/model.md`, section 9). For one object it gives the same motion.

Not supported, and refused: the inertial regime, loads that shift (a `push_height`, a table's edge),
friction laws other than "isotropic", and pushes by a force.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from gridpush_drake.dynamics.kernels.isotropic_friction import ISOTROPIC
from gridpush_drake.dynamics.kernels.scene.records import Pusher, SceneSteps
from gridpush_drake.dynamics.kernels.step import CONVERGED
from gridpush_drake.dynamics.motion import MotionStatus
from gridpush_drake.dynamics.physics import DEFAULT_PHYSICS, Physics, check_word
from gridpush_drake.dynamics.push import Push, check_times, make_times, measure_steps
from gridpush_drake.dynamics.scene.bodies import Scene, SceneBody, describe_object
from gridpush_drake.dynamics.scene.kernel_call import (
    make_bodies,
    make_scene_contacts,
    make_scene_state,
    run_scene_kernel,
)
from gridpush_drake.dynamics.scene.motion import SceneJacobian, SceneMotion
from gridpush_drake.dynamics.simulation import OVERLAP_TOLERANCE, check_record
from gridpush_drake.errors import SimulationError
from gridpush_drake.geometry.se2 import Array, IntArray

PUSH_COLUMNS = 4
"""Columns of derivatives of the push: start x, start y, direction, length."""

NO_BODY = -2
"""What stands in `SceneMotion.bodies` where there is no contact."""


def simulate_scene(
    scene: Scene | Iterable[SceneBody | Sequence[object]],
    push: Push,
    dt: float | None = None,
    gradients: bool = False,
    *,
    physics: Physics | None = None,
    times: ArrayLike | None = None,
    record: ArrayLike | None = None,
) -> SceneMotion:
    """Simulates one push of several objects, quasi-statically.

    Args:
        scene: the objects; or those of which to make one, with the default friction between them.
        push: the pusher's motion.
        dt: step, s; the last one is shortened to end with the push. By default so short that the
            pusher moves at most `DEFAULT_TIP_STEP` a step.
        gradients: whether the exact Jacobian of every recorded pose is added.
        physics: spin, gravity and tolerances; `Physics()` by default. The regime "auto" is
            "quasi_static" here.
        times: (T+1,) the steps' times, s from the push's beginning, instead of `dt`.
        record: indices into the T+1 steps whose Jacobian is wanted, negative ones from the end; all
            by default.

    Returns:
        The motion. Its `status` says whether the pusher touched an object and every step was
        solved.

    Raises:
        SimulationError: an argument is out of range, two objects overlap, or something is asked for
            that scenes do not support, see above.
    """
    whole = scene if isinstance(scene, Scene) else Scene(scene)
    check_word("gradients", gradients, (False, True))
    used = check_scene_physics(physics, whole)
    if not isinstance(push, Push):
        raise SimulationError(
            f"push is a {type(push).__name__}; expected a Push: a scene is quasi-static, and a "
            "force alone has no speed there"
        )
    # When the steps end, and which of their poses are differentiated.
    times = make_times(push, dt, used.regime) if times is None else check_times(times, False)
    dts = measure_steps(push, times, used.regime)
    steps = len(dts)
    rows = np.arange(steps + 1) if record is None else check_record(record, steps)
    row_of_step = np.full(steps + 1, -1)
    row_of_step[rows] = np.arange(len(rows))
    J = np.empty((0, len(whole), 3, 0))
    if gradients:
        J = np.empty((len(rows), len(whole), 3, count_scene_columns(whole)))

    # The kernel, from rest.
    tip = push.tip_at(times)
    contacts = make_scene_contacts(len(whole))
    result = run_scene_kernel(
        make_bodies(whole, used),
        used,
        pusher=Pusher(tip=tip, path_length=push.length, radius=push.radius),
        state=make_scene_state(whole.poses),
        contacts=contacts,
        dts=dts,
        row_of_step=row_of_step,
        J=J,
    )
    # Rows beyond a step's contacts hold what an earlier step left there.
    beyond = np.arange(result.modes.shape[1]) >= result.counts[:, None]
    bodies = result.ids[:, :, :2].copy()
    bodies[beyond] = NO_BODY
    result.points[beyond] = np.nan
    room = int(result.counts.max(initial=0))
    return SceneMotion(
        names=tuple(describe_object(whole.objects, i) for i in range(len(whole))),
        times=times,
        poses=result.poses,
        tip=tip,
        bodies=bodies[:, :room],
        forces=result.forces[:, :room],
        points=result.points[:, :room],
        modes=result.modes[:, :room],
        gaps=result.gaps[:, :room],
        finger_gaps=result.finger_gaps,
        status=_find_status(result, int(contacts.lost[0])),
        residuals=result.residuals,
        iterations=result.statuses[:, 1],
        physics=used,
        _jacobian=expand_columns(whole, used, J, rows) if gradients else None,
    )


def check_scene_physics(physics: Physics | None, scene: Scene) -> Physics:
    """Refuses what scenes do not support, and replaces the regime "auto" by "quasi_static".

    Raises:
        SimulationError: names what it is, and what is expected.
    """
    used = physics or DEFAULT_PHYSICS
    if used.regime == "inertial":
        raise SimulationError(
            "regime is 'inertial'; expected 'quasi_static': a scene's bodies have no momentum"
        )
    if used.law is not ISOTROPIC:
        raise SimulationError(
            f"friction_law is {used.friction_law!r}; expected 'isotropic', the one that scenes know"
        )
    for i, params in enumerate(scene.params):
        name = describe_object(scene.objects, i)
        if params.push_height > 0:
            raise SimulationError(
                f"{name}: push_height is {params.push_height:g} m; expected 0: loads do not shift "
                "in a scene"
            )
        if params.friction @ params.mass * used.gravity <= 0:
            raise SimulationError(
                f"{name}: friction is zero; the quasi-static regime needs some friction with the "
                "support"
            )
    return replace(used, regime="quasi_static")


def count_scene_columns(scene: Scene) -> int:
    """Counts the kernel's columns of derivatives, see `kernels.scene.step_derivative`."""
    n = len(scene)
    cells = sum(obj.n for obj in scene.objects)
    return cells + n + n * (n - 1) // 2 + PUSH_COLUMNS + 3 * n


def expand_columns(scene: Scene, physics: Physics, J: Array, rows: IntArray) -> SceneJacobian:
    """Makes named blocks of the kernel's columns J (R, N, 3, width), by k_i = mu_i m_i g."""
    # the columns, in the kernel's order
    n = len(scene)
    sizes = [obj.n for obj in scene.objects]
    pairs = n * (n - 1) // 2
    ends = np.cumsum([*sizes, n, pairs, 2, 1, 1, 3 * n])
    *loads, finger, pair, start, direction, length, pose = np.split(J, ends[:-1], axis=-1)
    by_pair = np.zeros((*J.shape[:3], n, n))
    # one number stands in two places of the matrix
    i, j = np.triu_indices(n, 1)
    by_pair[..., i, j] = pair
    by_pair[..., j, i] = pair
    each = list(zip(loads, scene.params, strict=True))
    return SceneJacobian(
        steps=rows,
        mass=tuple(load * (params.friction * physics.gravity) for load, params in each),
        friction=tuple(load * (params.mass * physics.gravity) for load, params in each),
        contact_friction=finger,
        pair_friction=by_pair,
        start=start,
        direction=direction[..., 0],
        length=length[..., 0],
        pose=pose.reshape(*J.shape[:3], n, 3),
    )


def _find_status(result: SceneSteps, lost: int) -> MotionStatus:
    if (result.statuses[:, 0] != CONVERGED).any() or lost > 0:
        return MotionStatus.NOT_CONVERGED
    with_finger = result.ids[:, :, 1] < 0
    if not (result.modes[with_finger] != 0).any():
        return MotionStatus.NO_CONTACT
    if result.finger_gaps[0] < -OVERLAP_TOLERANCE:
        return MotionStatus.STARTED_OVERLAPPING
    return MotionStatus.OK
