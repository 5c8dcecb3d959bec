"""What a rollout is given and what it records, as named tuples that compiled code takes."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.dynamics.kernels.compiled import kernel

Array = NDArray[np.float64]


class Body(NamedTuple):
    """The object, as the kernels know it.

    Mass, center of mass and inertia are zero in the quasi-static regime, where they do not act.

    Attributes:
        cells: (2, n) cell centers p_BC, m.
        k: (n,) friction each cell can carry, N.
        mass: kg.
        com_x, com_y: center of mass, m.
        inertia: about it, kg m².
        gyration_radius: of the cells' places, m: the scale of lengths.
        cell_size: m.
        contact_friction: with the pusher.
    """

    cells: Array
    k: Array
    mass: float
    com_x: float
    com_y: float
    inertia: float
    gyration_radius: float
    cell_size: float
    contact_friction: float


class Load(NamedTuple):
    """What drives the body during T steps.

    Attributes:
        tip: (T+1, 2) the disc's center, m.
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


class Pushes(NamedTuple):
    """P pushes by a disc, S steps in all.

    Attributes:
        first: (P+1,) the first step of each push, and S.
        dts: (S,) steps, s, or as `push.measure_steps` has them.
        tips: (S+P, 2) the disc's center before each step and at each push's end, m.
        path_lengths: (P,) of the disc's whole path, m.
        radii: (P,) of the disc, m.
        poses: (P, 3) q at the beginning.
    """

    first: NDArray[np.int64]
    dts: Array
    tips: Array
    path_lengths: Array
    radii: Array
    poses: Array


class Scheme(NamedTuple):
    """How the steps are taken.

    Attributes:
        inertial: the regime.
        ahead: fraction of a step after which it looks at the body: 0.5, or 0.
        stiction: tolerance of the inertial regime, m/s.
        relative_stiction: the least tolerance, as a fraction of the speed.
        early_end: residual, as a fraction of the load, below which the Newton step that follows is
            taken to solve the step, without being checked; 0 for none.
    """

    inertial: bool
    ahead: float
    stiction: float
    relative_stiction: float
    early_end: float


class Steps(NamedTuple):
    """What the kernel records of T steps, W unless said otherwise.

    Attributes:
        poses: (T+1, 3), m and rad.
        twists: (T, 3) of B's origin, in the frame of the step (the body's, turned by ahead dt times
            the last yaw rate).
        velocities: (T+1, 3) of B's origin, m/s and rad/s.
        contact_forces: (T, 2, 2), N.
        contact_points: (T, 2, 2), m.
        modes: (T, 2) contact modes.
        gaps: (T+1,), m.
        load_centers: (T, 2) of what the cells bear, m; NaN where loads do not shift.
        tips: (T,) whether no loads can hold the body.
        statuses: (T, 2) status and iterations.
    """

    poses: Array
    twists: Array
    velocities: Array
    contact_forces: Array
    contact_points: Array
    modes: NDArray[np.int64]
    gaps: Array
    load_centers: Array
    tips: NDArray[np.bool_]
    statuses: NDArray[np.int64]


def make_record(steps: int) -> Steps:
    """Makes an unfilled record of so many steps; compiled code calls `make_steps`."""
    return Steps(
        poses=np.empty((steps + 1, 3)),
        twists=np.empty((steps, 3)),
        velocities=np.empty((steps + 1, 3)),
        contact_forces=np.empty((steps, 2, 2)),
        contact_points=np.empty((steps, 2, 2)),
        modes=np.empty((steps, 2), np.int64),
        gaps=np.empty(steps + 1),
        load_centers=np.empty((steps, 2)),
        tips=np.empty(steps, np.bool_),
        statuses=np.empty((steps, 2), np.int64),
    )


make_steps = kernel()(make_record)
"""`make_record` for compiled code. To hand the arrays over to Python would take longer than to make
them there."""


@kernel()
def take_first_steps(record, steps):
    """Takes the part of a record that holds its first steps; it shares the record's arrays."""
    return Steps(
        poses=record.poses[: steps + 1],
        twists=record.twists[:steps],
        velocities=record.velocities[: steps + 1],
        contact_forces=record.contact_forces[:steps],
        contact_points=record.contact_points[:steps],
        modes=record.modes[:steps],
        gaps=record.gaps[: steps + 1],
        load_centers=record.load_centers[:steps],
        tips=record.tips[:steps],
        statuses=record.statuses[:steps],
    )
