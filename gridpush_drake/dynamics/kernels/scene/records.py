"""What a scene's rollout is given, works with and records, as named tuples that kernels take.

N bodies, M cells in all, P pairs of bodies, T steps, and room for R contacts a step.
"""

from typing import Any, NamedTuple

import numpy as np

FINGER_BODY = -1
"""What stands for the pusher where a contact names its second body."""

FIRST_BODY, SECOND_BODY, VERTEX, ROW_FEATURE = range(4)
"""Places in a contact's identity: the body whose outline is touched; the one that touches it, or
`FINGER_BODY`; the vertex of the second's core that does; and the edge of the first's outline or
core. Where a face of the pusher touches vertex v of the first's outline, the vertex is -1 - v (see
`contacts.name_touched_vertex`) and the edge is the pusher's."""

IDENTITY_SIZE = 4
"""Numbers in a contact's identity."""

(
    ROW_NX,
    ROW_NY,
    ROW_CX,
    ROW_CY,
    OTHER_NX,
    OTHER_NY,
    OTHER_CX,
    OTHER_CY,
    ROW_GAP,
    TIP_VX,
    TIP_VY,
    FRICTION,
    ROW_BEND,
    FIRST_BEND,
    FIRST_X,
    FIRST_Y,
) = range(16)
"""Places in a contact's numbers.

Normal N, into the first body, and contact point c, in the frame of the first body's step; the same
two in that of the second's; the gap, m; the pusher's velocity in the first body's frame; the
friction coefficient; whether a vertex of the first is touched (`contact`); and of the nearest
contact when the step begins, whether it is at a vertex, and that vertex or else its normal."""

CONTACT_SIZE = 16
"""Numbers that describe a contact."""


class BodyArrays(NamedTuple):
    """The bodies, as the kernels know them; all cells, edges and corners stand one after another.

    Attributes:
        first_cell: (N+1,) the first cell of each body, and M.
        cells: (2 M,) cell centers p_BC, m: of each body the x of all its cells, then their y.
        cell_size: (N,) side of each body's cells, m.
        laws, law_places: the friction laws, see `body_laws`.
        load: (N,) friction that all cells of a body can carry, N.
        arm: (N,) radius of gyration of the cells' places, m.
        reach: (N,) farthest point of the outline from B's origin, m.
        box: (N, 4) least x and y and greatest x and y of each core, body frame, m.
        finger_friction: (N,) with the pusher.
        pair_friction: (N, N) between two bodies.
        outline: `Edges` of all outlines, which the pusher touches; `previous` counts within a body.
        first_edge: (N+1,) the first of each body's.
        core: `Edges` of all cores, which touch each other: outlines moved inwards by `corner`.
        first_corner: (N+1,) the first of each body's.
        convex: (V,) whether the vertex where an edge of a core begins is convex.
        corner: (N,) radius of the corners, m.
    """

    first_cell: Any
    cells: Any
    cell_size: Any
    laws: Any
    law_places: Any
    load: Any
    arm: Any
    reach: Any
    box: Any
    finger_friction: Any
    pair_friction: Any
    outline: Any
    first_edge: Any
    core: Any
    first_corner: Any
    convex: Any
    corner: Any


class Tool(NamedTuple):
    """The shape of the pusher, in its own frame: all points within a radius of its core.

    Attributes:
        radius: m; negative where there is no pusher.
        core: `Edges` of a convex polygon, or edges without length, each of which is a disc's
            center.
        joined: whether the edges have faces, as those of a polygon do.
        reach: farthest point from the frame's origin, m.
    """

    radius: float
    core: Any
    joined: bool
    reach: float


class PusherPath(NamedTuple):
    """The motion of the pusher; W.

    Attributes:
        tip: (T+1, 2) the origin of its frame, m.
        yaw: (T+1,) angle of its frame, rad.
        path_length: of the origin's whole path, m.
        tool: its shape.
        variations: (D, T+1, 3) ways to vary the path, of x, y, m, and yaw, rad, by which poses are
            differentiated beside the four of `step_derivative`.
    """

    tip: Any
    yaw: Any
    path_length: float
    tool: Tool
    variations: Any


class ToolMotion(NamedTuple):
    """The pusher in one step; W.

    Attributes:
        x, y, yaw: where its frame is when the step begins, m and rad.
        vx, vy: velocity of its origin, m/s.
        rate: angular velocity, rad/s.
        turn_c, turn_s: cosine and sine of the yaw.
        turn_vc, turn_vs: mean change of both in the step, 1/s.
        tool: its shape.
    """

    x: float
    y: float
    yaw: float
    vx: float
    vy: float
    rate: float
    turn_c: float
    turn_s: float
    turn_vc: float
    turn_vs: float
    tool: Tool


class Tolerances(NamedTuple):
    """How steps are taken.

    Attributes:
        ahead: fraction of a step after which it looks at the bodies.
        relative_stiction: tolerance of stiction, as a fraction of the speed.
    """

    ahead: float
    relative_stiction: float


class BodyStates(NamedTuple):
    """Where the bodies are and how they move.

    Attributes:
        q: (N, 3) poses, m and rad.
        turn: (N, 2) cosine and sine of their angles.
        twist: (N, 3) of the step before, in the frame of its end, m/s and rad/s.
        before: (N, 3) of the one before that.
        moved: (N,) steps moved in a row, up to `step_memory.MOVING`.
        tilt, friction: (2,) of the loads of one body in the step before, see `support_loads`.
    """

    q: Any
    turn: Any
    twist: Any
    before: Any
    moved: Any
    tilt: Any
    friction: Any


class Contacts(NamedTuple):
    """The contacts of a step, as rows.

    Attributes:
        ids: (R, 4) who touches whom where.
        numbers: (R, 16) see above.
        lam: (R, 2) forces lam_n, lam_t, N.
        modes: (R,) see `contact_modes`.
        last_ids, last_modes: those of the step before.
        counts: (2,) contacts of the step, and of the one before.
        lost: (1,) contacts for which there was no room, in all steps.
    """

    ids: Any
    numbers: Any
    lam: Any
    modes: Any
    last_ids: Any
    last_modes: Any
    counts: Any
    lost: Any


class SceneSteps(NamedTuple):
    """What is recorded of T steps; W.

    Attributes:
        poses: (T+1, N, 3), m and rad.
        twists: (T, N, 3) in the frames of the step.
        counts: (T,) contacts of each step, which fill the first rows of the next arrays.
        ids: (T, R, 4).
        modes: (T, R).
        forces: (T, R, 2) on the first body, N.
        points: (T, R, 2) m.
        gaps: (T, R) at the step's beginning, m.
        finger_gaps: (T+1,) of the pusher to the nearest outline, m; infinite where far.
        statuses: (T, 2) status and iterations.
        residuals: (T, 2) of the balance of forces and of the contact conditions, see
            `kernels.scene.step`.
        load_centers: (T, 2) of what the cells of one body bear, m; NaN where loads do not shift.
        tips: (T,) whether no loads can hold it.
    """

    poses: Any
    twists: Any
    counts: Any
    ids: Any
    modes: Any
    forces: Any
    points: Any
    gaps: Any
    finger_gaps: Any
    statuses: Any
    residuals: Any
    load_centers: Any
    tips: Any


def make_body_states(n: int) -> BodyStates:
    """Makes the state of n bodies at rest; compiled code calls it as a kernel, as what follows."""
    return BodyStates(
        q=np.zeros((n, 3)),
        turn=np.zeros((n, 2)),
        twist=np.zeros((n, 3)),
        before=np.zeros((n, 3)),
        moved=np.zeros(n, np.int64),
        tilt=np.zeros(2),
        friction=np.zeros(2),
    )


def make_contacts(room: int) -> Contacts:
    """Makes room for contacts; none is there."""
    return Contacts(
        ids=np.zeros((room, IDENTITY_SIZE), np.int64),
        numbers=np.zeros((room, CONTACT_SIZE)),
        lam=np.zeros((room, 2)),
        modes=np.zeros(room, np.int64),
        last_ids=np.zeros((room, IDENTITY_SIZE), np.int64),
        last_modes=np.zeros(room, np.int64),
        counts=np.zeros(2, np.int64),
        lost=np.zeros(1, np.int64),
    )


def make_scene_record(steps: int, n: int, room: int) -> SceneSteps:
    """Makes an unfilled record of so many steps of n bodies, with room for contacts."""
    return SceneSteps(
        poses=np.empty((steps + 1, n, 3)),
        twists=np.empty((steps, n, 3)),
        counts=np.empty(steps, np.int64),
        ids=np.zeros((steps, room, IDENTITY_SIZE), np.int64),
        modes=np.zeros((steps, room), np.int64),
        forces=np.zeros((steps, room, 2)),
        points=np.zeros((steps, room, 2)),
        gaps=np.zeros((steps, room)),
        finger_gaps=np.empty(steps + 1),
        statuses=np.empty((steps, 2), np.int64),
        residuals=np.empty((steps, 2)),
        load_centers=np.full((steps, 2), np.nan),
        tips=np.zeros(steps, np.bool_),
    )
