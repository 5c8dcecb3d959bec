"""A push near the table's edge: the loads that the cells bear follow what still lies on the table.

While all of the object is on the table this is `simulate`, quasi-static. Once some of it hangs over, the push is cut
into short pieces; before each, the loads are calculated anew (`calc_load_distribution`), and with them the friction
of every cell. The object falls where no loads can hold it.

`calc_load_distribution`: what each cell bears of the weight when some of the object hangs over the edge.

A cell is a foot at its center, as stiff as it is heavy (as the plant's contact spheres): on the table altogether, every
foot bears its own cell's weight. Pressed in by a rigid body that sinks and tilts, foot i bears

    N_i = m_i g max(0, a.phi_i),    phi_i = (1, x_i, y_i),    for the feet on the table, 0 for the others

with a such that force and moments balance, sum N_i phi_i = g sum m_i phi_i. That is the stationary point of the convex

    f(a) = 1/2 sum_held m_i max(0, a.phi_i)^2 - a.sum_all m_i phi_i

found by Newton's method. f has no minimum where the center of mass is outside the hull of the held feet: the object
then tips, and falls.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.dynamics.time_grid import make_path_times
from gridpush_drake.errors import PlanningError
from gridpush_drake.geometry.convex import calc_margin_inside, hull_of
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.support_surface import SupportSurface, find_supported

Array = NDArray[np.float64]

NEWTON_STEPS = 60
TOLERANCE = 1e-10
"""Relative, of the balance."""

MIN_SLOPE = 1e-12
"""Relative, added to the Hessian where the feet that bear are in a line."""

HALVINGS = 40


def calc_load_distribution(obj: GridObject, mass: Array, held: NDArray[np.bool_]) -> Array | None:
    """Calculates the loads, as masses.

    Args:
        obj: the object.
        mass: (n,) of its cells, kg.
        held: (n,) whether a cell's foot is on the table.

    Returns:
        (n,) N_i/g, kg, which sum to the total mass; None where the object tips.
    """
    if held.all():
        return mass.copy()
    # lengths of order one: the Hessian is then well conditioned
    scale = obj.radius_of_gyration
    phi = np.column_stack([np.ones(obj.n), (obj.p_BC - obj.p_BC.mean(axis=0)) / scale])
    wanted = (mass @ phi) / mass.sum()
    if calc_margin_inside(wanted[None, 1:], hull_of(phi[held, 1:])) <= 0:
        return None
    stiffness = np.where(held, mass, 0.0) / mass.sum()
    load = _balance(stiffness, phi, wanted)
    return load * mass.sum() / load.sum()


def _balance(stiffness: Array, phi: Array, wanted: Array) -> Array:
    """(n,) loads that balance, by Newton's method with a line search on f."""

    def value(a: Array) -> float:
        return float(0.5 * stiffness @ np.maximum(phi @ a, 0.0) ** 2 - a @ wanted)

    a = np.array([1.0 / stiffness.sum(), 0.0, 0.0])
    for _ in range(NEWTON_STEPS):
        press = np.maximum(phi @ a, 0.0)
        gradient = (stiffness * press) @ phi - wanted
        if np.abs(gradient).max() < TOLERANCE:
            break
        bears = stiffness * (press > 0)
        H = (phi * bears[:, None]).T @ phi
        step = -np.linalg.solve(H + MIN_SLOPE * max(np.trace(H), stiffness.max()) * np.eye(3), gradient)
        before, slope, size = value(a), float(gradient @ step), 1.0
        for _ in range(HALVINGS):
            if value(a + size * step) <= before + 1e-4 * size * slope:
                break
            size /= 2
        a = a + size * step
    return np.asarray(stiffness * np.maximum(phi @ a, 0.0))


PIECE = 0.003
"""m of the pusher's path between calculations of the loads."""

NO_LOAD = 1e-9
"""Share of the total mass that a cell without a load is given, for masses must be positive."""


@dataclass(frozen=True, eq=False)
class EdgeMotion:
    """What became of the object.

    Attributes:
        poses: (K, 3) along the push, the first before it, m and rad.
        traveled: (K,) m of the pusher's path at each.
        fell: whether the object fell off the table; the poses end where it did.
    """

    poses: Array
    traveled: Array
    fell: bool

    @property
    def final_pose(self) -> Array:
        """(3,) the last pose."""
        return self.poses[-1]


def is_supported(obj: GridObject, params: CellParameters, pose: ArrayLike, surface: SupportSurface) -> bool:
    """Whether an object at rest at a pose (3,) stays on the table."""
    return calc_load_distribution(obj, params.mass, find_supported(obj, pose, surface)) is not None


def simulate_near_edge(
    obj: GridObject,
    params: CellParameters,
    push: Push,
    pose: ArrayLike,
    surface: SupportSurface,
    piece: float = PIECE,
) -> EdgeMotion:
    """Simulates a slow push of an object that may hang over the edge.

    Args:
        obj: the object.
        params: its cells' masses and frictions.
        push: the pusher's motion.
        pose: (3,) X_WB at the beginning, m and rad.
        surface: the table.
        piece: m of the pusher's path between calculations of the loads.

    Returns:
        The motion.

    Raises:
        PlanningError: `piece` is not positive.
    """
    if not (np.isfinite(piece) and piece > 0):
        raise PlanningError(f"piece is {piece!r}; expected a positive number (m)")
    q = np.array(pose, dtype=np.float64)
    times = make_path_times(push, "quasi_static")
    traveled = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(push.tip_at(times), axis=0), axis=1)))
    whole = simulate(obj, params, push, q, times=times, regime="quasi_static")
    on_table = find_supported(obj, whole.poses, surface).all(axis=1)
    if on_table.all():
        return EdgeMotion(whole.poses, traveled, False)
    # up to here nothing hangs over; go on from there in pieces
    first = max(int(np.argmin(on_table)) - 1, 0)
    poses, done, q = [whole.poses[: first + 1]], [traveled[: first + 1]], whole.poses[first]
    while first < len(times) - 1:
        load = calc_load_distribution(obj, params.mass, find_supported(obj, q, surface))
        if load is None:
            return EdgeMotion(np.concatenate(poses), np.concatenate(done), True)
        last = min(max(int(np.searchsorted(traveled, traveled[first] + piece)), first + 1), len(times) - 1)
        part = Push.along(times[first : last + 1], push.tip_at(times[first : last + 1]), push.radius)
        loaded = CellParameters(
            np.maximum(load, NO_LOAD * load.sum()), params.friction, params.contact_friction
        )  # fmt: skip
        motion = simulate(obj, loaded, part, q, times=times[first : last + 1] - times[first], regime="quasi_static")
        poses.append(motion.poses[1:])
        done.append(traveled[first + 1 : last + 1])
        q, first = motion.final_pose, last
    fell = not is_supported(obj, params, q, surface)
    return EdgeMotion(np.concatenate(poses), np.concatenate(done), fell)
