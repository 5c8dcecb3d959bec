"""Paths of stable pushes: a few pushes under which an object goes with the pusher as if glued.

A *grip* is a place where a pusher of two contacts or more lies flush against the outline. From it
a frame S of the body, at X_BS, is led as a car is, by arcs of bounded curvature (`grips`). The last
push is a Dubins curve of S (`dubins`) to the goal X_WG,

    from X_WB X_BS to X_WG X_BS.

Before it there are further arcs, from other grips or the same one. Each moves the body by

    X_BB' = X_BS arc(k, s) X_SB,

whatever its pose, so that these are listed once, for all grips, curvatures and lengths. Of all
sequences the planner takes that of least cost,

    lengths of all pieces + REGRIP_COST (number of pushes),

which is stable from the first piece to the last by the wanted fraction of draws. Its pushes are
then simulated by some of the draws: where an object slips, its end says how far.

The theory is in `docs/theory/planning.md`, section 9. Pushes by a disc, under which an object turns
away, are planned by `goal.push_plan`.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from gridpush_drake.dynamics.bodies import Bodies
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.pusher import Pusher, PusherShape
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import PlanningError
from gridpush_drake.geometry.se2 import (
    Array,
    IntArray,
    check_vector,
    compose,
    invert,
    make_direction,
    transform,
)
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.belief import Belief
from gridpush_drake.planning.contact.trial import calc_goal_error
from gridpush_drake.planning.push_constraints import PushChecker, PushConstraints
from gridpush_drake.planning.stable.dubins import FULL_TURN, find_dubins_curves, move_along_arc
from gridpush_drake.planning.stable.grips import FRACTIONS, STABLE_MARGIN, Grip, find_grips

STABLE_PROBABILITY = 0.95
"""Least probability by default that the object slips nowhere on the path."""

CONE_DRAWS = 50
"""Draws of a model by which twists are judged."""

END_DRAWS = 10
"""Draws of a model by which the chosen pushes are simulated."""

ARC_LENGTHS = (0.03, 0.06, 0.1, 0.15, 0.2, 0.3)
"""Lengths of the arcs before the last push, m."""

MAX_TURN = np.pi
"""Greatest turn of such an arc, rad."""

STRAIGHT = FRACTIONS.index(0.0)
"""Number of the straight line in `FRACTIONS`."""

TURN_PAIRS = ((0, 4), (1, 3))
"""Numbers in `FRACTIONS` of the turns to the right and to the left of a Dubins curve."""

REGRIP_COST = 0.15
"""Length of path that a further push counts as, m: it has to be approached, and each time object
and pusher come to lie flush anew."""

MAX_PUSHES = 3
"""Pushes of a path at most."""

MAX_COST = 5.0
"""Cost above which no path is made, m."""

KEPT_SEQUENCES = 300
"""Number of the cheapest sequences that are looked at of each grip, goal and pair of turns."""

PLACE_HEADINGS = 16
"""Angles of the object at a goal that is a place, which are tried."""

PLACE_PUSHES = 2
"""Pushes of a path to a place at most: any of its angles will do."""

SAMPLE_SPACING = 0.002
"""Distance between samples of a push's path, m."""

SHORTEST_PIECE = 1e-6
"""Pieces of a path that are shorter are left out, m."""


class StablePush(NamedTuple):
    """One push of a path.

    Attributes:
        grip: where the pusher touches the object.
        push: the pusher's motion, which begins with a gap and closes it.
        poses: (K, 3) poses of the object if it does not slip, X_WB, m and rad; the first one is
            that before the push.
        curvatures: (P,) curvatures of the arcs and lines along which the pusher's frame S goes,
            1/m.
        lengths: (P,) lengths of these arcs and lines, m.
    """

    grip: Grip
    push: Push
    poses: Array
    curvatures: Array
    lengths: Array


@dataclass(frozen=True, eq=False)
class StablePath:
    """Stable pushes that bring an object to a goal.

    Attributes:
        start: (3,) where the object lies, X_WB, m and rad.
        goal: (3,) where it gets to if it does not slip, X_WB, m and rad.
        pushes: the pushes, in order.
        margins: (M,) by each draw the least margin along the path: the sine of the angle by which
            the contact forces are within what the contacts bear; negative where the object slips.
        ends: (K, 3) where the object ends by some of the draws, simulated, X_WB, m and rad.
        errors: (K,) mean distances of its cells there from the goal's, m.
    """

    start: Array
    goal: Array
    pushes: tuple[StablePush, ...]
    margins: Array
    ends: Array
    errors: Array

    @property
    def probability(self) -> float:
        """Fraction of the draws by which the object slips nowhere."""
        return float((self.margins > 0).mean())

    @property
    def length(self) -> float:
        """Length of the path, m."""
        return float(sum(each.lengths.sum() for each in self.pushes))


def plan_stable_path(
    known: Model | Belief,
    pusher: Pusher,
    pose: ArrayLike,
    goal: ArrayLike,
    *,
    probability: float = STABLE_PROBABILITY,
    constraints: PushConstraints | None = None,
    seed: int = 0,
) -> StablePath | None:
    """Plans stable pushes that bring an object to a goal.

    Args:
        known: the object, with what is known of its parameters.
        pusher: of a shape with two contacts or more; its speed and clearance are used.
        pose: (3,) where the object lies, X_WB, m and rad.
        goal: (3,) where it should get to, X_WB, or (2,) the place of B's origin alone, m and rad.
        probability: that the object slips nowhere, at least.
        constraints: where object and pusher may be; anywhere by default.
        seed: of the draws.

    Returns:
        The path; None where none is found that is allowed and as stable as wanted.

    Raises:
        PlanningError: an argument is out of range, or the pusher has one contact only.
        SimulationError: there are several objects.
    """
    start = check_vector(PlanningError, "pose", pose, 3)
    shape = _require_shape(pusher)
    if not 0 < probability <= 1:
        raise PlanningError(f"probability is {probability!r}; expected more than 0, at most 1")
    goals = _list_goals(goal)
    bodies, draws = _draw(known, seed)
    grips = find_grips(bodies, shape, draws[:CONE_DRAWS], probability)
    if not grips:
        return None
    checker = None
    if constraints is not None and not constraints.is_free:
        checker = constraints.start_at(bodies.obj, start, shape.radius)

    arcs = _list_arcs(grips)
    before = _Beginnings(np.full((1, MAX_PUSHES - 1), -1), start[None], np.zeros(1))
    cost = MAX_COST
    best: tuple[_Sequence, tuple[StablePush, ...]] | None = None
    for number in range(MAX_PUSHES if len(goals) == 1 else PLACE_PUSHES):
        if number > 0:
            before = _go_on(before, arcs)
        # longer sequences are of use only where they cost less
        for sequence in _close_all(grips, before, arcs, goals, cost):
            if not (sequence.margins > STABLE_MARGIN).mean() >= probability:
                continue
            pushes = _make_pushes(grips, sequence.pieces, start, pusher, shape)
            if checker is None or _are_allowed(pushes, checker):
                best = sequence, pushes
                cost = sequence.cost
                break
    if best is None:
        return None
    sequence, pushes = best
    ends = _simulate_ends(bodies, draws[:END_DRAWS], pushes, start)
    errors = calc_goal_error(bodies.obj, ends, sequence.goal)
    return StablePath(
        start=start,
        goal=sequence.goal,
        pushes=pushes,
        margins=sequence.margins,
        ends=ends,
        errors=errors,
    )


def _require_shape(pusher: Pusher) -> PusherShape:
    """Takes a pusher's shape; raises PlanningError of a disc."""
    if pusher.shape is None or len(pusher.shape.core) < 2:
        raise PlanningError(
            "pusher: one disc, under which an object turns away; expected a shape of two contacts"
        )
    return pusher.shape


def _list_goals(goal: ArrayLike) -> Array:
    """Lists the poses (G, 3) that count as the goal."""
    if np.shape(goal) == (3,):
        return check_vector(PlanningError, "goal", goal, 3)[None]
    place = check_vector(PlanningError, "goal", goal, 2)
    angles = FULL_TURN * np.arange(PLACE_HEADINGS) / PLACE_HEADINGS
    return np.column_stack([np.broadcast_to(place, (PLACE_HEADINGS, 2)), angles])


def _draw(known: Model | Belief, seed: int) -> tuple[Bodies, list[CellParameters]]:
    """Draws parameters of one object: those of a belief are its estimate and its samples."""
    if isinstance(known, Belief):
        samples = [sample.params for sample in known.samples]
        return known.bodies, [known.params, *samples]
    physics = known.physics.with_regime("quasi_static")
    return known.with_physics(physics), known.draws(CONE_DRAWS, seed)


class Piece(NamedTuple):
    """An arc or a line of a path.

    Attributes:
        grip: number of the grip.
        curvature: its number in `FRACTIONS`.
        length: m.
    """

    grip: int
    curvature: int
    length: float


class _Arcs(NamedTuple):
    """All arcs before the last push.

    Attributes:
        grip: (A,) numbers of the grips.
        curvature: (A,) numbers of the curvatures in `FRACTIONS`.
        length: (A,) m.
        motion: (A, 3) X_BB' of the body, m and rad.
    """

    grip: IntArray
    curvature: IntArray
    length: Array
    motion: Array


def _list_arcs(grips: Sequence[Grip]) -> _Arcs:
    """Lists the arcs of all grips."""
    rows = []
    motions = []
    for g, grip in enumerate(grips):
        for i, k in enumerate(grip.curvatures):
            if FRACTIONS[i] != 0 and k == 0:
                continue
            for length in ARC_LENGTHS:
                if abs(k) * length > MAX_TURN:
                    continue
                after = move_along_arc(grip.X_BS, k, length)
                rows.append((g, i, length))
                motions.append(compose(after, invert(grip.X_BS)))
    table = np.array(rows).reshape(-1, 3)
    return _Arcs(
        table[:, 0].astype(np.int64),
        table[:, 1].astype(np.int64),
        table[:, 2],
        np.reshape(motions, (-1, 3)),
    )


class _Beginnings(NamedTuple):
    """What may come before the last push.

    Attributes:
        arcs: (N, MAX_PUSHES - 1) numbers of the arcs, the last one last; -1 where there is none.
        poses: (N, 3) of the object after them, X_WB, m and rad.
        cost: (N,) of them, m.
    """

    arcs: IntArray
    poses: Array
    cost: Array


def _go_on(shorter: _Beginnings, arcs: _Arcs) -> _Beginnings:
    """Lists beginnings of one arc more."""
    count = len(arcs.grip)
    earlier = np.repeat(np.arange(len(shorter.cost)), count)
    arc = np.tile(np.arange(count), len(shorter.cost))
    numbers = np.column_stack([shorter.arcs[earlier, 1:], arc])
    regrip = _find_grip(shorter, arcs)[earlier] != arcs.grip[arc]
    cost = shorter.cost[earlier] + arcs.length[arc] + REGRIP_COST * regrip
    return _Beginnings(numbers, compose(shorter.poses[earlier], arcs.motion[arc]), cost)


def _find_grip(before: _Beginnings, arcs: _Arcs) -> IntArray:
    """Finds the numbers (N,) of the grips that beginnings end with; -1 where there is none."""
    last = before.arcs[:, -1]
    return np.where(last >= 0, arcs.grip[last], -1)


class _Sequence(NamedTuple):
    """Pieces that end at a goal.

    Attributes:
        cost: m.
        goal: (3,) X_WB, m and rad.
        pieces: the pieces, in order.
        margins: (M,) the least of their margins by each draw.
    """

    cost: float
    goal: Array
    pieces: list[Piece]
    margins: Array


def _close_all(
    grips: Sequence[Grip], before: _Beginnings, arcs: _Arcs, goals: Array, limit: float
) -> Iterator[_Sequence]:
    """Ends beginnings at one of the goals (G, 3), in the order of their cost.

    Args:
        grips: of the last pushes.
        before: the beginnings.
        arcs: the arcs of which they are made.
        goals: X_WB, m and rad.
        limit: cost above which sequences are left out, m.
    """
    found = [
        each
        for g in range(len(grips))
        for goal in goals
        for each in _close(grips, g, before, arcs, goal, limit)
    ]
    margins: dict[frozenset[tuple[int, int]], Array] = {}
    for cost, goal, pieces in sorted(found, key=lambda each: each[0]):
        # how long a piece is does not matter for its margin
        used = frozenset((piece.grip, piece.curvature) for piece in pieces)
        if used not in margins:
            margins[used] = np.min([grips[g].margins[:, i] for g, i in used], axis=0)
        yield _Sequence(cost, goal, pieces, margins[used])


def _close(
    grips: Sequence[Grip], g: int, before: _Beginnings, arcs: _Arcs, goal: Array, limit: float
) -> Iterator[tuple[float, Array, list[Piece]]]:
    """Ends beginnings by Dubins curves from the grip of number `g` at a goal (3,).

    Yields:
        Cost, goal and pieces of the cheapest sequences: at most `KEPT_SEQUENCES` for each pair of
        turns.
    """
    grip = grips[g]
    begin = compose(before.poses, grip.X_BS)
    end = compose(goal, grip.X_BS)
    spent = before.cost + REGRIP_COST * (_find_grip(before, arcs) != g)
    # no curve is shorter than the straight line
    rows = np.flatnonzero(spent + np.linalg.norm(begin[:, :2] - end[:2], axis=1) < limit)
    for right, left in TURN_PAIRS:
        curves = find_dubins_curves(begin[rows], end, *grip.curvatures[[right, left]])
        numbers = np.select([curves.curvatures > 0, curves.curvatures < 0], [left, right], STRAIGHT)
        costs = (curves.lengths.sum(axis=-1) + spent[rows, None]).ravel()
        cheapest = np.argsort(costs, kind="stable")[:KEPT_SEQUENCES]
        for i in cheapest[costs[cheapest] < limit].tolist():
            row, word = divmod(i, len(numbers))
            first = before.arcs[rows[row]]
            pieces = [
                Piece(int(arcs.grip[a]), int(arcs.curvature[a]), float(arcs.length[a]))
                for a in first[first >= 0]
            ]
            last = zip(numbers[word].tolist(), curves.lengths[row, word].tolist(), strict=True)
            pieces += [Piece(g, k, length) for k, length in last if length > SHORTEST_PIECE]
            if pieces:
                yield float(costs[i]), goal, pieces


def _make_pushes(
    grips: Sequence[Grip],
    pieces: Sequence[Piece],
    start: Array,
    pusher: Pusher,
    shape: PusherShape,
) -> tuple[StablePush, ...]:
    """Makes the pushes of a sequence of pieces from a start (3,): one for each grip in turn."""
    pushes = []
    X_WB = start
    first = 0
    while first < len(pieces):
        g = pieces[first].grip
        last = first
        while last < len(pieces) and pieces[last].grip == g:
            last += 1
        made = _make_push(grips[g], pieces[first:last], X_WB, pusher, shape)
        pushes.append(made)
        X_WB = made.poses[-1]
        first = last
    return tuple(pushes)


def _make_push(
    grip: Grip, pieces: Sequence[Piece], X_WB: Array, pusher: Pusher, shape: PusherShape
) -> StablePush:
    """Makes the push of pieces from one grip, with the object at X_WB (3,) before it."""
    curvatures = grip.curvatures[[piece.curvature for piece in pieces]]
    lengths = np.array([piece.length for piece in pieces])
    begin = compose(X_WB, grip.X_BS)
    steered = [begin[None]]
    for k, length in zip(curvatures, lengths, strict=True):
        gone = length * np.linspace(0, 1, int(np.ceil(length / SAMPLE_SPACING)) + 1)[1:]
        steered.append(move_along_arc(steered[-1][-1], k, gone))
    poses = compose(np.concatenate(steered), invert(grip.X_BS))
    X_WT = compose(poses, grip.X_BT)
    # before it, the pusher closes the gap
    if pusher.clearance > 0:
        ahead = grip.contacts.normals.mean(axis=0)
        away = X_WT[0].copy()
        away[:2] -= pusher.clearance * make_direction(X_WB[2] + np.arctan2(ahead[1], ahead[0]))
        X_WT = np.concatenate([away[None], X_WT])
        poses = np.concatenate([poses[:1], poses])
    moved = np.hypot(
        np.linalg.norm(np.diff(X_WT[:, :2], axis=0), axis=1), shape.reach * np.diff(X_WT[:, 2])
    )
    t = np.append(0.0, np.cumsum(moved)) / pusher.speed
    push = Push.along(t, X_WT[:, :2], shape=shape, yaw=X_WT[:, 2])
    return StablePush(grip, push, poses, curvatures, lengths)


def _are_allowed(pushes: Sequence[StablePush], checker: PushChecker) -> bool:
    """Whether object and pusher may be where pushes bring them."""
    for each in pushes:
        assert each.push.shape is not None and each.push.yaw is not None
        X_WT = np.column_stack([each.push.xy, each.push.yaw])
        corners = transform(X_WT, each.push.shape.core).reshape(-1, 2)
        if not (checker.allows_finger(corners).all() and checker.allows_poses(each.poses).all()):
            return False
    return True


def _simulate_ends(
    bodies: Bodies,
    draws: Sequence[CellParameters],
    pushes: Sequence[StablePush],
    start: Array,
) -> Array:
    """Simulates by each draw where the object ends (K, 3), X_WB, m and rad."""
    ends = []
    for params in draws:
        drawn = bodies.with_params(params)
        pose = start
        for each in pushes:
            pose = simulate(drawn, each.push, pose).final_pose
        ends.append(pose)
    return np.array(ends)
