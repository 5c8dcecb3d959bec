"""The call of the compiled rollout of a scene: objects in, arrays through, a record of steps out.

It checks nothing: `simulation` and `GridSceneSystem` do, before they come here.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.dynamics.bodies import Bodies
from gridpush_drake.dynamics.kernel_call import NO_SUPPORT
from gridpush_drake.dynamics.kernels.contact.contact import Edges
from gridpush_drake.dynamics.kernels.friction.friction_law import calc_spin_lever_arm
from gridpush_drake.dynamics.kernels.scene.body_laws import copy_laws, join_laws
from gridpush_drake.dynamics.kernels.scene.records import (
    BodyArrays,
    BodyStates,
    Contacts,
    PusherPath,
    SceneSteps,
    Tolerances,
    Tool,
    make_body_states,
    make_contacts,
    make_scene_record,
)
from gridpush_drake.dynamics.kernels.scene.rollout import rollout_scene
from gridpush_drake.dynamics.kernels.support_loads import Support
from gridpush_drake.dynamics.physics import Physics
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.pusher import PusherShape
from gridpush_drake.dynamics.scene.cores import calc_outline_reach, get_core
from gridpush_drake.geometry.polygons import OutlineEdges
from gridpush_drake.geometry.se2 import Array, IntArray, rotate
from gridpush_drake.objects.grid_object import GridObject

YAW, TURN, CENTER_X, CENTER_Y = range(4)
"""Ways in which the path of a pusher that is no disc is varied: all yaws by as much; in proportion
to how far it has turned, by one radian at the end, its places held; and by moving the center of
rotation, the start and the yaws held."""

PATH_VARIATIONS = 4
"""Number of them."""

KEPT_SHAPES = 16
"""Number of sets of objects whose cells and outlines are kept for the next push."""

CONTACTS_A_BODY = 16
"""Contacts within reach for which there is room, for each body."""

CONTACTS_A_DISC = 2
"""Most contacts of a disc with an outline."""


def make_bodies(bodies: Bodies) -> BodyArrays:
    """Collects what the kernels know of several objects."""
    # what every cell can bear, and the law of each object
    physics = bodies.physics
    k = [params.friction * params.mass * physics.gravity for params in bodies.parameters]
    members = list(bodies)
    laws = [
        physics.law.make(loads, calc_spin_lever_arm(obj, params), physics.used_spin)
        for (obj, params), loads in zip([*members, members[0]], [*k, k[0].copy()], strict=True)
    ]
    entries, places = join_laws(laws[:-1], laws[-1])
    shapes = _join_shapes(tuple(bodies.objects))
    return BodyArrays(
        first_cell=shapes.first_cell,
        cells=shapes.cells,
        cell_size=shapes.cell_size,
        laws=entries,
        law_places=places,
        load=np.array([float(loads.sum()) for loads in k]),
        arm=shapes.arm,
        reach=shapes.reach,
        box=shapes.box,
        finger_friction=np.array([float(params.contact_friction) for params in bodies.parameters]),
        pair_friction=np.array(bodies.pair_friction),
        outline=shapes.outline,
        first_edge=shapes.first_edge,
        core=shapes.core,
        first_corner=shapes.first_corner,
        convex=shapes.convex,
        corner=shapes.corner,
    )


class JoinedShapes(NamedTuple):
    """What the kernels know of objects' cells and outlines; the fields are `BodyArrays`'."""

    first_cell: IntArray
    cells: Array
    cell_size: Array
    arm: Array
    reach: Array
    box: Array
    outline: Edges
    first_edge: IntArray
    core: Edges
    first_corner: IntArray
    convex: NDArray[np.bool_]
    corner: Array


@lru_cache(maxsize=KEPT_SHAPES)
def _join_shapes(objects: tuple[GridObject, ...]) -> JoinedShapes:
    """Joins objects' cells and outlines; no kernel changes them."""
    # outlines for the pusher, cores for each other
    cores = [get_core(obj) for obj in objects]
    outlines = [obj.edges for obj in objects]
    return JoinedShapes(
        first_cell=_count_up([obj.n for obj in objects]),
        cells=np.concatenate([obj.p_BC.T.ravel() for obj in objects]),
        cell_size=np.array([float(obj.cell_size) for obj in objects]),
        arm=np.array([float(obj.radius_of_gyration) for obj in objects]),
        reach=np.array([calc_outline_reach(obj) for obj in objects]),
        box=np.array(
            [
                np.concatenate([core.edges.start.min(axis=0), core.edges.start.max(axis=0)])
                for core in cores
            ]
        ),
        outline=_join_edges(outlines),
        first_edge=_count_up([len(edges.start) for edges in outlines]),
        core=_join_edges([core.edges for core in cores]),
        first_corner=_count_up([len(core.edges.start) for core in cores]),
        convex=np.concatenate([core.convex for core in cores]),
        corner=np.array([core.radius for core in cores]),
    )


def make_scene_state(poses: Array) -> BodyStates:
    """Makes the state of N bodies at rest at poses (N, 3)."""
    state = make_body_states(len(poses))
    state.q[:] = poses
    return state


def count_contact_room(n: int, tool: Tool | None = None) -> int:
    """Counts the contacts of n bodies for which there is room; as of `make_scene_contacts`."""
    room = CONTACTS_A_BODY * n
    if n == 1 and tool is not None and not tool.joined:
        room = min(room, CONTACTS_A_DISC * len(tool.core.ax))
    return room


def make_tolerances(physics: Physics) -> Tolerances:
    """Collects how steps are taken."""
    return Tolerances(
        ahead=physics.ahead, relative_stiction=float(physics.relative_stiction_tolerance)
    )


def make_scene_contacts(n: int, tool: Tool | None = None) -> Contacts:
    """Makes room for the contacts of n bodies; none is there.

    A body alone needs less room where the pusher is known to be a `tool` of discs.
    """
    return make_contacts(count_contact_room(n, tool))


def make_tool(shape: PusherShape) -> Tool:
    """Collects what the kernels know of a pusher's shape."""
    corners = shape.core
    places = np.arange(len(corners))
    # an edge of no length at each of several discs
    ends = np.roll(corners, -1, axis=0) if shape.joined else corners
    return Tool(
        radius=shape.radius,
        core=Edges(
            ax=corners[:, 0].copy(),
            ay=corners[:, 1].copy(),
            bx=ends[:, 0].copy(),
            by=ends[:, 1].copy(),
            previous=np.roll(places, 1) if shape.joined else places,
        ),
        joined=shape.joined,
        reach=shape.reach,
    )


def make_pusher_path(push: Push, times: Array, varied: bool = False) -> PusherPath:
    """Samples a push at times (T+1,), s.

    Args:
        push: the push.
        times: when, s from its beginning.
        varied: whether a shape's path is varied in all `PATH_VARIATIONS` ways, for derivatives; a
            disc's never is.
    """
    ways = PATH_VARIATIONS if varied and push.shape is not None else 0
    variations = np.zeros((ways, len(times), 3))
    yaw = push.yaw_at(times)
    if ways and push.yaw is not None:
        variations[YAW, :, 2] = 1.0
        turned = push.yaw - push.yaw[0]
        # every sample of the path varies; between samples, the path is straight
        if turned[-1] != 0:
            variations[TURN, :, 2] = np.interp(times, push.t, turned / turned[-1])
        # Moves e of the center of rotation, from which the start does not move: (1 - R) e.
        for axis in (0, 1) if turned.any() else ():
            e = np.eye(2)[axis]
            moves = e - rotate(turned, e)
            for a in (0, 1):
                variations[CENTER_X + axis, :, a] = np.interp(times, push.t, moves[:, a])
    return PusherPath(
        tip=push.tip_at(times),
        yaw=yaw,
        path_length=push.length,
        tool=make_tool(push.shape or PusherShape.disc(push.radius)),
        variations=variations,
    )


def run_scene_kernel(
    bodies: BodyArrays,
    physics: Physics,
    *,
    pusher: PusherPath,
    state: BodyStates,
    contacts: Contacts,
    dts: Array,
    row_of_step: IntArray,
    J: Array,
    support: Support = NO_SUPPORT,
) -> SceneSteps:
    """Simulates T steps.

    Args:
        bodies: the objects.
        physics: quasi-static.
        pusher: the pusher's path.
        state: of the bodies at the beginning; updated in place.
        contacts: of the step before; updated in place.
        dts: (T,) steps as `push.measure_steps` has them.
        row_of_step: (T+1,) row of J that records this step, -1 for none.
        J: (rows, N, 3, width) filled; without columns where no derivative is wanted.
        support: what the loads of one object depend on; by default none shift.

    Returns:
        The record.
    """
    record = make_scene_record(len(dts), len(state.q), len(contacts.modes))
    rollout_scene(
        bodies=bodies._replace(laws=copy_laws(bodies.laws)),
        support=support,
        pusher=pusher,
        tolerances=make_tolerances(physics),
        state=state,
        contacts=contacts,
        dts=dts,
        row_of_step=row_of_step,
        record=record,
        J=J,
    )
    return record


def _count_up(lengths: Sequence[int]) -> IntArray:
    """Where each of several parts of such lengths begins, and the end of the last."""
    return np.append(0, np.cumsum(lengths, dtype=np.int64))


def _join_edges(parts: Sequence[OutlineEdges]) -> Edges:
    """Joins the edges of several outlines; `previous` goes on counting within each."""
    start = np.concatenate([edges.start for edges in parts])
    end = np.concatenate([edges.end for edges in parts])
    return Edges(
        ax=np.array(start[:, 0]),
        ay=np.array(start[:, 1]),
        bx=np.array(end[:, 0]),
        by=np.array(end[:, 1]),
        previous=np.concatenate([np.asarray(edges.previous, np.int64) for edges in parts]),
    )
