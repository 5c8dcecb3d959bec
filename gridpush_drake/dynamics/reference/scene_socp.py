"""A quasi-static step of several bodies in maximal coordinates, as a sequence of cone programs.

It is slow and independent of the kernel, which is tested against it. Every cell of every body has
three velocities of its own, [theta_dot, x_dot, y_dot], each body seen from its own frame, and rows
J_e that hold the cells of a body together. Friction with the table is

    sum over cells of k_i |(kappa w_i, v_i)|  +  k_i arm |w_i|

with kappa = arm for "coupled" spin and the last term for "separate" spin alone. The contact of two
bodies with the relative velocity u = (u_n, u_t) obeys Coulomb's law where

    |mu u_t| <= u_n + s,    s = mu |u_t|

(de Saxcé's form of it). For a given s that is one cone more, so that the step is a convex program,
whose multipliers are the contact forces; s is found by repeating it.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.sparse import block_diag, csc_array, csr_array, diags_array, vstack

from gridpush_drake.dynamics.bodies import Bodies
from gridpush_drake.dynamics.kernels.friction.friction_law import calc_spin_lever_arm
from gridpush_drake.dynamics.reference.isotropic_socp import clarabel, solve_conic
from gridpush_drake.dynamics.reference.maximal_lcp import (
    STANDARD_GRAVITY,
    make_maximal_lcp,
    twist_to_cells,
)
from gridpush_drake.errors import SimulationError
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters

MAX_PROGRAMS = 200
"""Most programs of a step."""

UNDAMPED_PROGRAMS = 30
"""Programs after which only half of a change of s is made."""

SETTLED_CHANGE = 1e-9
"""Change of s, as a fraction of the speed, that ends the repetition."""

ORIGIN_POSE = np.zeros(3)
"""Pose at which every body is seen from its own frame."""


class ContactSide(NamedTuple):
    """One side of a contact.

    Attributes:
        body: the number of the body.
        normal: (2,) unit normal N, in the frame of the body.
        point: (2,) where it is touched, in the frame of the body, m.
    """

    body: int
    normal: Array
    point: Array


class SceneContact(NamedTuple):
    """A contact of two bodies, or of the pusher with one.

    Attributes:
        first: the side into which the normal points.
        second: the other side, with the same normal seen from there; None of the pusher.
        velocity: (2,) of the pusher in the first body's frame, m/s; zeros where there is none.
        gap: m.
        friction: friction coefficient mu.
        compliance: of normal and tangential force, (m/s)/N.
    """

    first: ContactSide
    second: ContactSide | None
    velocity: Array
    gap: float
    friction: float
    compliance: float


class SceneSolution(NamedTuple):
    """The solution of a step.

    Attributes:
        twists: (N, 3) of every body's origin in its own frame, m/s and rad/s.
        forces: (C, 2) lam_n and lam_t of every contact, N.
    """

    twists: Array
    forces: Array


def solve_scene_socp(
    objects: Sequence[GridObject],
    params: Sequence[CellParameters],
    contacts: Sequence[SceneContact],
    dt: float,
    speed: float,
    g: float = STANDARD_GRAVITY,
    spin: str = "coupled",
) -> SceneSolution:
    """Takes one quasi-static step of several bodies.

    Args:
        objects: the N objects.
        params: their cells' masses and frictions.
        contacts: all that may touch.
        dt: the step, s.
        speed: of the pusher, m/s; the scale of the program.
        g: gravity, m/s².
        spin: "coupled", "separate" or "none".

    Returns:
        Twists and contact forces.

    Raises:
        SimulationError: the repetition did not settle, or the solver failed.
    """
    # Per body: friction, rigidity, and cells' velocities from the twist; scaled to a speed of one
    # and to the load of all cells.
    starts = 3 * np.cumsum([0, *(obj.n for obj in objects)])
    size = int(starts[-1])
    k = [each.friction * each.mass * g for each in params]
    load = float(np.concatenate(k).sum())
    rigid = block_diag(
        [
            make_maximal_lcp(
                Bodies(obj, each), ORIGIN_POSE, np.zeros(3 * obj.n), np.zeros(3 * obj.n), 1.0
            ).J_e
            for obj, each in zip(objects, params, strict=True)
        ]
    )
    cones = []
    for obj, each, loads, start in zip(objects, params, k, starts, strict=False):
        arm = calc_spin_lever_arm(obj, each)
        for i in range(obj.n):
            row = int(start) + 3 * i
            kappa = arm if spin == "coupled" else 0.0
            cones.append((loads[i] / load, [(row, kappa), (row + 1, 1.0), (row + 2, 1.0)]))
            if spin == "separate":
                cones.append((arm * loads[i] / load, [(row, 1.0)]))
    rows = _make_contact_rows(objects, contacts, starts)
    asked = np.array(
        [
            (
                each.first.normal @ each.velocity / speed - each.gap / (dt * speed),
                (each.first.normal[0] * each.velocity[1] - each.first.normal[1] * each.velocity[0])
                / speed,
            )
            for each in contacts
        ]
    ).reshape(-1, 2)
    compliance = np.array([each.compliance * load / speed for each in contacts])
    friction = np.array([each.friction for each in contacts])
    program = _Program(
        cones=cones,
        rigid=rigid,
        rows=rows,
        asked=asked,
        compliance=compliance,
        friction=friction,
        size=size,
    )

    shift = np.zeros(len(contacts))
    for repetition in range(MAX_PROGRAMS):
        velocities, slip, forces = program.solve(shift)
        new = friction * np.abs(slip)
        change = float(np.abs(new - shift).max(initial=0.0))
        shift = new if repetition < UNDAMPED_PROGRAMS else (shift + new) / 2
        if change <= SETTLED_CHANGE:
            twists = [
                np.linalg.lstsq(
                    twist_to_cells(obj, ORIGIN_POSE),
                    velocities[start : start + 3 * obj.n],
                    rcond=None,
                )[0]
                for obj, start in zip(objects, starts, strict=False)
            ]
            return SceneSolution(np.array(twists) * speed, forces * load)
    raise SimulationError(f"the slip of {len(contacts)} contacts did not settle")


def _make_contact_rows(
    objects: Sequence[GridObject], contacts: Sequence[SceneContact], starts: Array
) -> csr_array:
    """Makes the rows (2C, 3n) of u_n and u_t, by the velocities of one cell of each body."""
    rows = np.zeros((2 * len(contacts), int(starts[-1])))
    for c, contact in enumerate(contacts):
        for side, sign in ((contact.first, 1.0), (contact.second, -1.0)):
            if side is None:
                continue
            place = int(starts[side.body])
            arm = side.point - objects[side.body].p_BC[0]
            normal = side.normal
            tangent = np.array([-normal[1], normal[0]])
            for row, along in ((2 * c, normal), (2 * c + 1, tangent)):
                moment = arm[0] * along[1] - arm[1] * along[0]
                rows[row, place : place + 3] += sign * np.array([moment, *along])
    return csr_array(rows)


class _Program:
    """The cone program of a step, solved for one s after another.

    Unknowns: all cells' velocities; a bound t for each norm; and for each contact what it gives
    way, in both directions.
    """

    def __init__(
        self,
        cones: list[tuple[float, list[tuple[int, float]]]],
        rigid: csr_array,
        rows: csr_array,
        asked: Array,
        compliance: Array,
        friction: Array,
        size: int,
    ) -> None:
        count = len(friction)
        total = size + len(cones) + 2 * count
        stiffness = np.repeat(1.0 / compliance, 2) if count else np.empty(0)
        self._P = csc_array(diags_array(np.concatenate([np.zeros(size + len(cones)), stiffness])))
        self._q = np.concatenate(
            [np.zeros(size), [weight for weight, _ in cones], np.zeros(2 * count)]
        )
        # rigidity: zero cones
        none = csr_array((rigid.shape[0], total - size))
        blocks = [csr_array(np.hstack([rigid.toarray(), none.toarray()]))]
        kinds: list[object] = [clarabel.ZeroConeT(rigid.shape[0])]
        # norms: t, then what it bounds
        for index, (_, entries) in enumerate(cones):
            block = np.zeros((1 + len(entries), total))
            block[0, size + index] = -1.0
            for line, (column, value) in enumerate(entries):
                block[1 + line, column] = -value
            blocks.append(csr_array(block))
            kinds.append(clarabel.SecondOrderConeT(1 + len(entries)))
        # contacts: u_n + s, then mu u_t; each with what gives way
        dense = rows.toarray()
        for c in range(count):
            block = np.zeros((2, total))
            for line, scale in ((0, 1.0), (1, friction[c])):
                block[line, :size] = -scale * dense[2 * c + line]
                block[line, size + len(cones) + 2 * c + line] = -scale
            blocks.append(csr_array(block))
            kinds.append(clarabel.SecondOrderConeT(2))
        self._A = csc_array(vstack(blocks))
        self._kinds = kinds
        self._dense = dense
        self._asked = asked
        self._friction = friction
        self._size = size

    def solve(self, shift: Array) -> tuple[Array, Array, Array]:
        """Solves it for s (C,): cells' velocities, slips (C,), and forces (C, 2)."""
        count = len(shift)
        b = np.zeros(self._A.shape[0])
        for c in range(count):
            row = len(b) - 2 * count + 2 * c
            b[row] = shift[c] - self._asked[c, 0]
            b[row + 1] = -self._friction[c] * self._asked[c, 1]
        x, z = solve_conic(self._P, self._q, self._A, self._kinds, b)
        give = x[len(x) - 2 * count :].reshape(count, 2)
        velocities = x[: self._size]
        slip = self._dense[1::2] @ velocities - self._asked[:, 1] + give[:, 1]
        forces = z[len(z) - 2 * count :].reshape(count, 2).copy()
        forces[:, 1] *= self._friction
        return velocities, slip, forces
