"""`simulate` and `simulate_batch`: the grid object under a push."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from math import ceil
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridpush_drake.dynamics.force_push import ForcePush
from gridpush_drake.dynamics.friction import SPIN_ARM, SPIN_MODELS
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.rollout import rollout
from gridpush_drake.dynamics.sensitivity import OTHER
from gridpush_drake.dynamics.simulation import (
    STATUS_NO_CONTACT,
    STATUS_NOT_CONVERGED,
    STATUS_OK,
    STATUS_STARTED_OVERLAPPING,
    RawJacobian,
    Simulation,
)
from gridpush_drake.dynamics.step import CONVERGED
from gridpush_drake.errors import SimulationError
from gridpush_drake.grid.object import GridObject
from gridpush_drake.grid.parameters import CellParameters

Array = NDArray[np.float64]
Regime = Literal["inertial", "quasi_static"]

GRAVITY = 9.81
"""m/s²."""

DEFAULT_DT = 0.01
"""s, the longest step where none is given."""

DEFAULT_TIP_STEP = 0.001
"""m, the furthest the pusher moves in a step where none is given."""

STICTION_TOLERANCE = 1e-9
"""m/s, of the inertial regime; a body at rest creeps slower than a few of these."""

OVERLAP_TOLERANCE = 1e-4
"""m, of pusher and outline at the beginning."""


def simulate(
    obj: GridObject,
    params: CellParameters,
    push: Push | ForcePush,
    pose: ArrayLike = (0.0, 0.0, 0.0),
    dt: float | None = None,
    gradients: bool | Literal["paper"] = False,
    *,
    velocity: ArrayLike = (0.0, 0.0, 0.0),
    regime: Regime = "inertial",
    friction: Literal["isotropic", "lagged"] = "isotropic",
    spin: Literal["coupled", "separate", "none"] = "coupled",
    gravity: float = GRAVITY,
    times: ArrayLike | None = None,
    record: ArrayLike | None = None,
    stiction_tolerance: float = STICTION_TOLERANCE,
) -> Simulation:
    """Simulates one push of a grid object (`design/physics.md`, sections 3-5).

    Args:
        obj: the object.
        params: its cells' masses and frictions.
        push: the pusher's motion, or a force applied to the object.
        pose: (3,) q = (x, y, theta) of B in W at the beginning, m and rad.
        dt: step, s; the last one is shortened to end with the push. By default at most `DEFAULT_DT`, and so short that
            the pusher moves at most `DEFAULT_TIP_STEP` a step.
        gradients: True adds the exact Jacobian of every recorded pose; "paper" the paper's closed form, of each step by
            itself.
        velocity: (3,) (vx, vy, w) of B's origin in W at the beginning; inertial regime only.
        regime: "inertial", or "quasi_static": the limit of slow pushes, where only the cells' shares of the friction
            matter, not the masses, nor how fast the pusher goes.
        friction: "isotropic" (implicit, exact at the transition from stick to slip) or "lagged", the paper's LCP,
            whose friction directions are those of the step before.
        spin: how the cells resist spinning, see `dynamics.friction`; "lagged" friction is always "separate".
        gravity: m/s².
        times: (T+1,) the steps' times, s from the push's beginning, instead of `dt`.
        record: indices into the T+1 poses whose Jacobian is wanted; all by default.
        stiction_tolerance: speed below which friction is smoothed, m/s; inertial regime only.

    Returns:
        The motion. Its `status` says whether the pusher touched and every step was solved.

    Raises:
        SimulationError: an argument is out of range, or the combination makes no sense.
    """
    inertial = _check_regime(regime, push, friction, spin, gradients)
    if params.n != obj.n:
        raise SimulationError(f"parameters of {params.n} cells; expected {obj.n}, as {obj.name} has")
    q, nu = _vector3("pose", pose), _vector3("velocity", velocity)
    if not inertial and nu.any():
        raise SimulationError("velocity: the quasi-static regime has none; expected (0, 0, 0)")
    times = _make_times(push, dt) if times is None else _check_times(times)
    steps = len(times) - 1
    tip, force, force_point, radius = _sample(push, times, q)

    k = params.friction * params.mass * gravity
    spin_arm = SPIN_ARM * obj.cell_size
    model = "separate" if friction == "lagged" else spin
    spin_terms = np.array(
        [
            spin_arm**2 if model == "coupled" else 0.0,
            k.sum() * spin_arm if model == "separate" else 0.0,
            spin_arm if model == "separate" else 0.0,
        ]
    )
    if not inertial and k.sum() <= 0:
        raise SimulationError("friction: the quasi-static regime needs some friction with the support")
    com = params.centre_of_mass(obj)
    moments = np.array([params.total_mass, com[0], com[1], params.inertia(obj), obj.radius_of_gyration])
    exact = gradients is True
    rows = np.arange(steps + 1) if record is None else _check_record(record, steps)
    row_of_step = np.full(steps + 1, -1)
    row_of_step[rows] = np.arange(len(rows))
    J = np.empty((len(rows), 3, obj.n + OTHER)) if exact else np.empty((0, 3, 0))
    cells, edges, previous = _kernel_arrays(obj)

    poses, velocities, twists = np.empty((steps + 1, 3)), np.empty((steps + 1, 3)), np.empty((steps, 3))
    contact_forces, contact_points = np.empty((steps, 2, 2)), np.empty((steps, 2, 2))
    modes, statuses, gaps = (
        np.empty((steps, 2), np.int64),
        np.empty((steps, 2), np.int64),
        np.empty(steps + 1),
    )
    rollout(
        cells, k, spin_terms, friction == "lagged", edges, previous, radius, params.contact_friction, moments, inertial,
        float(stiction_tolerance), q, nu, tip, np.diff(times), force, force_point, row_of_step, poses, twists,
        velocities, contact_forces, contact_points, modes, gaps, statuses, J,
    )  # fmt: skip

    jacobian: Any = None
    if exact:
        tangent = push.start_tangent if isinstance(push, Push) else None
        jacobian = RawJacobian(
            rows, J, obj.p_BC, obj.cell_size, params.mass, params.friction, gravity, inertial, tangent
        )
    elif gradients == "paper":
        from gridpush_drake.dynamics.paper_rollout import calc_paper_jacobian

        jacobian = calc_paper_jacobian(obj, params, poses, velocities, twists, times, rows, gravity, model)
    return Simulation(
        times, poses, velocities, tip if radius > 0 else np.full_like(tip, np.nan), contact_forces, contact_points,
        modes, gaps, _status(radius > 0, modes, gaps, statuses), statuses[:, 1], jacobian,
    )  # fmt: skip


def simulate_batch(
    obj: GridObject,
    params: CellParameters | Sequence[CellParameters],
    pushes: Push | ForcePush | Sequence[Push | ForcePush],
    poses: ArrayLike = (0.0, 0.0, 0.0),
    *,
    workers: int | None = None,
    **options: Any,
) -> list[Simulation]:
    """Simulates many pushes, or parameter sets, or pairs of the two, on all cores.

    Args:
        obj: the object.
        params: one set for all, or one for each simulation.
        pushes: one push for all, or one for each simulation.
        poses: (3,) one pose for all, or (count, 3).
        workers: threads; by default one a core. The result does not depend on it.
        options: passed on to `simulate`.

    Returns:
        The simulations, in order.

    Raises:
        SimulationError: the lists' lengths disagree, or as `simulate`.
    """
    starts = np.asarray(poses, dtype=np.float64)
    lengths = [len(value) for value in (params, pushes) if isinstance(value, Sequence)]
    lengths += [len(starts)] if starts.ndim == 2 else []
    count = max(lengths, default=1)
    if any(length != count for length in lengths):
        raise SimulationError(
            f"params, pushes and poses of lengths {lengths}; expected equal lengths, or one for all"
        )
    jobs = [
        (
            params[i] if isinstance(params, Sequence) else params,
            pushes[i] if isinstance(pushes, Sequence) else pushes,
            starts[i] if starts.ndim == 2 else starts,
        )
        for i in range(count)
    ]
    with ThreadPoolExecutor(workers) as pool:
        return list(pool.map(lambda job: simulate(obj, job[0], job[1], job[2], **options), jobs))


def _check_regime(
    regime: str, push: Push | ForcePush, friction: str, spin: str, gradients: bool | str
) -> bool:
    for name, value, known in (
        ("regime", regime, ("inertial", "quasi_static")),
        ("friction", friction, ("isotropic", "lagged")),
        ("spin", spin, SPIN_MODELS),
        ("gradients", gradients, (False, True, "paper")),
    ):
        if value not in known:
            raise SimulationError(f"{name} is {value!r}; expected one of {', '.join(map(repr, known))}")
    if regime == "quasi_static" and isinstance(push, ForcePush):
        raise SimulationError(
            "regime: a force-driven push needs 'inertial'; a quasi-static body has no velocity of its own"
        )
    if regime == "quasi_static" and friction == "lagged":
        raise SimulationError("friction: 'lagged' needs the inertial regime, whose velocity it lags")
    if friction == "lagged" and gradients is True:
        raise SimulationError(
            "gradients: the exact ones need friction='isotropic'; 'lagged' has gradients='paper'"
        )
    return regime == "inertial"


def _vector3(name: str, value: ArrayLike) -> Array:
    vector = np.array(value, dtype=np.float64)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise SimulationError(f"{name} is {value!r}; expected three finite numbers")
    return vector


def _make_times(push: Push | ForcePush, dt: float | None) -> Array:
    if dt is not None and not (np.isfinite(dt) and dt > 0):
        raise SimulationError(f"dt is {dt!r}; expected a positive number (s)")
    if dt is not None:
        steps = max(1, ceil(push.duration / dt - 1e-9))
        return np.append(np.arange(steps) * dt, push.duration)
    if isinstance(push, ForcePush):
        return np.linspace(0.0, push.duration, max(1, ceil(push.duration / DEFAULT_DT - 1e-9)) + 1)
    return make_path_times(push)


def make_path_times(push: Push, tip_step: float = DEFAULT_TIP_STEP, longest: float = DEFAULT_DT) -> Array:
    """Times that cut each piece of the push's path evenly: at most `tip_step` (m) and `longest` (s) each; (T+1,), s."""
    distance = np.linalg.norm(np.diff(push.xy, axis=0), axis=1)
    counts = np.maximum(np.ceil(np.maximum(distance / tip_step, np.diff(push.t) / longest) - 1e-9), 1).astype(
        int
    )
    pieces = [
        push.t[i] + (push.t[i + 1] - push.t[i]) * np.arange(count) / count for i, count in enumerate(counts)
    ]
    return np.append(np.concatenate(pieces), push.t[-1])


def _check_times(times: ArrayLike) -> Array:
    times = np.array(times, dtype=np.float64)
    if times.ndim != 1 or len(times) < 2 or not np.isfinite(times).all() or (np.diff(times) <= 0).any():
        raise SimulationError("times: expected at least two finite, strictly increasing numbers (s)")
    return times


def _check_record(record: ArrayLike, steps: int) -> NDArray[np.int64]:
    rows = np.asarray(record, dtype=np.int64)
    if rows.ndim != 1 or (rows < 0).any() or (rows > steps).any() or len(np.unique(rows)) != len(rows):
        raise SimulationError(f"record: expected distinct indices from 0 to {steps}")
    return rows


def _sample(push: Push | ForcePush, times: Array, q: Array) -> tuple[Array, Array, Array, float]:
    """Tip (T+1, 2), force (T, 2), its point (2,), and the radius, negative where there is no pusher."""
    if isinstance(push, ForcePush):
        return np.zeros((len(times), 2)), push.force_during(times), np.array(push.point), -1.0
    return push.tip_at(times), np.zeros((len(times) - 1, 2)), np.zeros(2), push.radius


def _kernel_arrays(obj: GridObject) -> tuple[Array, Array, NDArray[np.int64]]:
    """The object as the kernel wants it, made once an object."""
    cached = obj.__dict__.get("_kernel_arrays")
    if cached is None:
        edges = obj.edges
        cached = (
            np.ascontiguousarray(obj.p_BC.T),
            np.ascontiguousarray(np.column_stack([edges.start, edges.end]).T),
            np.ascontiguousarray(edges.previous),
        )
        obj.__dict__["_kernel_arrays"] = cached
    return cached


def _status(has_pusher: bool, modes: NDArray[np.int64], gaps: Array, statuses: NDArray[np.int64]) -> str:
    if (statuses[:, 0] != CONVERGED).any():
        return STATUS_NOT_CONVERGED
    if has_pusher and not modes.any():
        return STATUS_NO_CONTACT
    if gaps[0] < -OVERLAP_TOLERANCE:
        return STATUS_STARTED_OVERLAPPING
    return STATUS_OK
