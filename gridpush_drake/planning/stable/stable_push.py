"""Stable pushes: twists of a pusher under which the object goes with it as if glued.

A rigid pusher touches the object at points p_k with normals N_k, into the object, and friction
coefficients mu_k. At the twist xi the table exerts the wrench

    w_s(xi) = -sum over cells of k_i (u_i, p_i x u_i + arm² w/s_i),   u_i = v_i/s_i

with v_i the cell's velocity, s_i its norm (with the cell's spin, arm w, as the friction law has it)
and k_i its friction limit. The object can move with the pusher if the contacts can balance that:

    -w_s(xi)  in  C = { sum of J_k^T f_k : f_k in the friction cone of contact k }

(Lynch and Mason 1996). The twists for which it holds are the contacts' *motion cone*. C has two
generators a contact. Its faces, and how far a wrench is from the nearest, come from their pairs.
Moments count by the radius of gyration of the cells, so that the margin is an angle: its sine.

How sure a push is to be stable is asked of draws of what a model does not know: the cells'
friction, that of the contacts, and their places. The theory is in `docs/theory/planning.md`,
section 9. The simulation says what happens where a push is not stable; here is only whether it is.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import nnls

from gridpush_drake.dynamics.kernels.friction.friction_law import calc_spin_lever_arm
from gridpush_drake.dynamics.physics import Physics
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.pusher import PusherShape
from gridpush_drake.errors import PlanningError, require_positive
from gridpush_drake.geometry.se2 import (
    Array,
    check_vector,
    compose,
    invert,
    rotate,
    transform,
)
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.contact.trial import calc_goal_offset

CONTACT_TOLERANCE = 0.002
"""Gap up to which a part of the pusher counts as touching, m: the object first comes to lie flush
with the pusher, and only then goes with it."""

DRAWS = 100
"""Draws of a model by which a probability is estimated; its standard error is then 5 % or less."""

CURVATURES = 41
"""Curvatures that are tried on each hand when the tightest stable turn is looked for."""

FACE_TOLERANCE = 1e-9
"""Sine of the angle by which a generator may be beyond a face of the cone, for rounding's sake."""

MIN_PIECE = 0.002
"""Shortest piece of a path whose twist is looked at, m; shorter ones are joined. Logged places are
rounded, which would turn the twists of short pieces."""

STILL = 1e-9
"""Way of a whole path, m, below which the pusher stands still."""

SIDE_SLACK = 0.2
"""Sine of the angle by which a corner of the pusher may stand back and still count as touching."""


class PusherContacts(NamedTuple):
    """Where a pusher touches an object, body frame.

    Attributes:
        points: (K, 2) on the outline, m.
        normals: (K, 2) unit normals into the object.
        gaps: (K,) distances from the pusher, m; negative where they overlap.
    """

    points: Array
    normals: Array
    gaps: Array


@dataclass(frozen=True, eq=False)
class PushStability:
    """How sure a push is to be stable.

    Attributes:
        margins: (M,) by each draw the least margin along the path: the sine of the angle from the
            wrench that the contacts must bear to the nearest face of their cone; negative beyond.
        contacts: where the pusher touches.
    """

    margins: Array
    contacts: PusherContacts

    @property
    def probability(self) -> float:
        """Fraction of the draws by which the object goes with the pusher all along the path."""
        return float((self.margins > 0).mean())

    @property
    def is_stable(self) -> bool:
        """Whether it does by most of them."""
        return self.probability > 0.5


def find_pusher_contacts(
    obj: GridObject,
    shape: PusherShape,
    pose: ArrayLike,
    tolerance: float = CONTACT_TOLERANCE,
) -> PusherContacts:
    """Finds where a pusher touches an object, or would once they lie flush.

    Args:
        obj: the object.
        shape: the pusher's.
        pose: (3,) X_BT of the pusher's frame in the body frame, m and rad.
        tolerance: gap up to which a part of the pusher counts as touching, m.

    Returns:
        The contacts: of corners or discs of the pusher with the outline, and of a polygon's faces
        with the outline's corners. There may be none.

    Raises:
        PlanningError: the pose is not three finite numbers, or the tolerance not positive.
    """
    X_BT = check_vector(PlanningError, "pose", pose, 3)
    require_positive(PlanningError, unit="m", tolerance=tolerance)
    points: list[Array] = []
    normals: list[Array] = []
    gaps: list[float] = []
    edges = obj.edges
    along = edges.end - edges.start
    tangents = along / np.linalg.norm(along, axis=1)[:, None]
    core = transform(X_BT, shape.core)
    count = len(core)
    for k, center in enumerate(core):
        # the nearest point of each edge, and the nearest of all
        fraction = np.einsum("ec,ec->e", center - edges.start, along) / (along**2).sum(axis=1)
        nearest = edges.start + np.clip(fraction, 0, 1)[:, None] * along
        distances = np.linalg.norm(nearest - center, axis=1)
        e = int(np.argmin(distances))
        outside = not shapely.contains_xy(obj.outline, *center)
        gap = distances[e] * (1 if outside else -1) - shape.radius
        # at a corner of the outline, a round part of the pusher touches along its own normal
        normal = np.array([-tangents[e, 1], tangents[e, 0]])
        if outside and not 0 < fraction[e] < 1:
            normal = (nearest[e] - center) / distances[e]
        if abs(gap) > tolerance + (0 if outside else shape.radius):
            continue
        beside = (core[[k - 1, (k + 1) % count]] - center) if shape.joined else np.zeros((1, 2))
        if (beside @ normal > SIDE_SLACK * np.linalg.norm(beside, axis=1)).any():
            continue
        points.append(nearest[e])
        normals.append(normal)
        gaps.append(float(gap))
    if shape.joined:
        for point, normal, gap in _find_touched_corners(obj, core, shape.radius, tolerance):
            points.append(point)
            normals.append(normal)
            gaps.append(gap)
    return PusherContacts(np.reshape(points, (-1, 2)), np.reshape(normals, (-1, 2)), np.array(gaps))


def _find_touched_corners(
    obj: GridObject, core: Array, radius: float, tolerance: float
) -> list[tuple[Array, Array, float]]:
    """Finds the outline's corners that faces of a polygon's core (K, 2) touch: normals and gaps."""
    found = []
    after = np.roll(core, -1, axis=0)
    along = after - core
    lengths = np.linalg.norm(along, axis=1)
    outward = np.column_stack([along[:, 1], -along[:, 0]]) / lengths[:, None]
    hull = shapely.get_coordinates(obj.outline.convex_hull)[:-1]
    for corner in hull:
        arms = corner - core
        distances = np.einsum("ec,ec->e", arms, outward)
        e = int(np.argmax(distances))
        place = arms[e] @ along[e]
        gap = float(distances[e]) - radius
        if abs(gap) <= tolerance and 0 < place < lengths[e] ** 2:
            found.append((corner, outward[e], gap))
    return found


class MotionCone:
    """The twists under which an object goes with a pusher, by one set of parameters.

    Attributes:
        obj: the object.
        contacts: where the pusher touches it.
    """

    def __init__(
        self,
        obj: GridObject,
        params: CellParameters,
        contacts: PusherContacts,
        physics: Physics | None = None,
    ) -> None:
        """Makes the cone.

        Args:
            obj: the object.
            params: its cells' masses and frictions, and the friction with the pusher.
            contacts: where the pusher touches it.
            physics: isotropic friction, of which the spin model counts; the default one by default.

        Raises:
            PlanningError: the friction law is another one.
        """
        used = physics or Physics()
        if used.friction_law != "isotropic":
            raise PlanningError(
                f"friction_law is {used.friction_law!r}; a motion cone is of 'isotropic' friction"
            )
        self.obj = obj
        self.contacts = contacts
        self._loads = params.relative_friction()
        self._arm = calc_spin_lever_arm(obj, params)
        self._spin = used.used_spin
        self._length = obj.radius_of_gyration
        self._generators = self._make_generators(params.contact_friction)
        self._faces = _find_faces(self._generators)

    def calc_margins(self, twists: ArrayLike) -> Array:
        """Calculates how far twists are inside the cone.

        Args:
            twists: (T, 3) of the object's origin in its own frame, m/s and rad/s, none zero; how
                fast they are does not matter.

        Returns:
            (T,) sines of the angle from the wrench that the contacts must bear to the nearest face
            of the cone of those that they can; negative where they cannot, and -1 at the most.
        """
        wrenches = self._calc_wrenches(np.array(twists, dtype=np.float64).reshape(-1, 3))
        if not len(self._generators):
            return np.full(len(wrenches), -1.0)
        if not len(self._faces):
            # contacts that span no volume, such as a single one
            return np.array([-nnls(self._generators.T, wrench)[1] for wrench in wrenches])
        return np.asarray((wrenches @ self._faces.T).min(axis=1))

    def contains(self, twists: ArrayLike) -> Array:
        """Tells under which of the twists (T, 3) the object goes with the pusher, (T,)."""
        return np.asarray(self.calc_margins(twists) > 0)

    def _calc_wrenches(self, twists: Array) -> Array:
        """Calculates the unit wrenches -w_s (T, 3), moments by the radius of gyration."""
        x, y = self.obj.p_BC.T
        u, v, w = (twists[:, i, None] for i in range(3))
        vx = u - w * y
        vy = v + w * x
        spin = np.broadcast_to(self._arm * w, vx.shape)
        coupled = spin if self._spin == "coupled" else np.zeros_like(spin)
        # a cell that stands still carries any friction; none is as good as another
        speed = np.sqrt(vx**2 + vy**2 + coupled**2)
        speed = np.where(speed > 0, speed, 1.0)
        moment = (x * vy - y * vx + self._arm * coupled) / speed
        if self._spin == "separate":
            moment = moment + self._arm * np.sign(spin)
        wrench = np.column_stack(
            [
                (vx / speed) @ self._loads,
                (vy / speed) @ self._loads,
                moment @ self._loads / self._length,
            ]
        )
        return np.asarray(wrench / np.linalg.norm(wrench, axis=1)[:, None])

    def _make_generators(self, friction: float) -> Array:
        """Makes the unit wrenches (2K, 3) of the edges of the contacts' friction cones."""
        points = self.contacts.points
        normals = self.contacts.normals
        tangents = np.column_stack([-normals[:, 1], normals[:, 0]])
        forces = np.concatenate([normals + friction * tangents, normals - friction * tangents])
        places = np.concatenate([points, points])
        moments = places[:, 0] * forces[:, 1] - places[:, 1] * forces[:, 0]
        wrenches = np.column_stack([forces, moments / self._length])
        return np.asarray(wrenches / np.linalg.norm(wrenches, axis=1)[:, None])


def _find_faces(generators: Array) -> Array:
    """Finds the faces of the cone of generators (G, 3): inward unit normals (F, 3)."""
    first, second = np.triu_indices(len(generators), 1)
    normals = np.cross(generators[first], generators[second])
    lengths = np.linalg.norm(normals, axis=1)
    normals = normals[lengths > FACE_TOLERANCE] / lengths[lengths > FACE_TOLERANCE, None]
    # all other generators are on one side of a face, and not all of them in it
    sides = normals @ generators.T
    inward = sides.min(axis=1, initial=0.0) >= -FACE_TOLERANCE
    outward = sides.max(axis=1, initial=0.0) <= FACE_TOLERANCE
    return np.concatenate([normals[inward & ~outward], -normals[outward & ~inward]])


def calc_push_stability(
    model: Model,
    push: Push,
    pose: ArrayLike = (0.0, 0.0, 0.0),
    *,
    count: int = DRAWS,
    seed: int = 0,
    place_std: float = 0.0,
    tolerance: float = CONTACT_TOLERANCE,
) -> PushStability:
    """Calculates how sure a push is to be stable, from its beginning to its end.

    Args:
        model: the object, with what is known of its parameters.
        push: by a shape with at least two contacts; its first pose is that at which it touches,
            but for the tolerance.
        pose: (3,) X_WB of the object at the beginning, m and rad.
        count: number of draws of the model.
        seed: seed of the draws.
        place_std: standard deviation of the place of each contact along and across the outline, m.
        tolerance: as of `find_pusher_contacts`.

    Returns:
        The margins by each draw.

    Raises:
        PlanningError: the pusher is a disc without a frame, or touches nowhere.
    """
    shape, X_WT, X_BT = _take_frames(push, pose)
    contacts = _require_contacts(model.obj, shape, X_BT, tolerance)
    twists = calc_twists(X_WT, calc_flush_pose(contacts, X_BT))
    rng = np.random.default_rng(seed)
    margins = []
    for params in model.draws(count, seed):
        points = contacts.points + place_std * rng.standard_normal(contacts.points.shape)
        cone = MotionCone(model.obj, params, contacts._replace(points=points), model.physics)
        margins.append(float(cone.calc_margins(twists).min()))
    return PushStability(np.array(margins), contacts)


def calc_flush_pose(contacts: PusherContacts, X_BT: ArrayLike) -> Array:
    """Calculates where the pusher's frame is in the body frame once all contacts are closed.

    Args:
        contacts: two or more, nearly closed.
        X_BT: (3,) where the frame is before, m and rad.

    Returns:
        (3,) the pose, m and rad: the turn and the shift that bring the pusher's points nearest to
        the outline's (least squares).
    """
    before = check_vector(PlanningError, "X_BT", X_BT, 3)
    touching = contacts.points - contacts.gaps[:, None] * contacts.normals
    mean_before = touching.mean(axis=0)
    mean_after = contacts.points.mean(axis=0)
    p = touching - mean_before
    q = contacts.points - mean_after
    turn = np.arctan2(
        (p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]).sum(), (p[:, 0] * q[:, 0] + p[:, 1] * q[:, 1]).sum()
    )
    place = mean_after + rotate(turn, before[:2] - mean_before)
    return np.array([*place, before[2] + turn])


class Slip(NamedTuple):
    """How far an object is from where it would be, had it gone with the pusher.

    Attributes:
        distance: of the cells' centroid, m.
        angle: rad.
    """

    distance: float
    angle: float

    def is_within(self, distance: float, angle: float) -> bool:
        """Whether the object slipped no farther than a distance, m, and an angle, rad."""
        return self.distance <= distance and self.angle <= angle


def calc_slip(
    obj: GridObject,
    push: Push,
    pose: ArrayLike,
    end: ArrayLike,
    tolerance: float = CONTACT_TOLERANCE,
) -> Slip:
    """Calculates how far an object slipped in a push, seen from the pusher, since they lay flush.

    Args:
        obj: the object.
        push: as of `calc_push_stability`.
        pose: (3,) X_WB at the beginning, m and rad.
        end: (3,) X_WB at the end, as simulated or observed.
        tolerance: as of `find_pusher_contacts`.

    Raises:
        PlanningError: the pusher is a disc without a frame, or touches nowhere.
    """
    shape, X_WT, X_BT = _take_frames(push, pose)
    contacts = _require_contacts(obj, shape, X_BT, tolerance)
    held = compose(X_WT[-1], invert(calc_flush_pose(contacts, X_BT)))
    reached = check_vector(PlanningError, "end", end, 3)
    return Slip(*calc_goal_offset(obj, reached, held))


def _take_frames(push: Push, pose: ArrayLike) -> tuple[PusherShape, Array, Array]:
    """Takes a push's shape, its frames X_WT (K, 3), and X_BT (3,) at the beginning."""
    X_WB = check_vector(PlanningError, "pose", pose, 3)
    if push.shape is None or push.yaw is None:
        raise PlanningError("push: by a disc without a frame; expected a push by a shape")
    X_WT = np.column_stack([push.xy, push.yaw])
    return push.shape, X_WT, compose(invert(X_WB), X_WT[0])


def _require_contacts(
    obj: GridObject, shape: PusherShape, X_BT: Array, tolerance: float
) -> PusherContacts:
    """Finds where a pusher touches; raises PlanningError where it does nowhere."""
    contacts = find_pusher_contacts(obj, shape, X_BT, tolerance)
    if not len(contacts.points):
        raise PlanningError(
            f"push: the pusher begins more than {tolerance:g} m off the outline; expected contact"
        )
    return contacts


def calc_twists(path: Array, X_BT: Array) -> Array:
    """Calculates the twists of an object that is held by a pusher.

    Args:
        path: (K, 3) poses X_WT of the pusher's frame, m and rad.
        X_BT: (3,) where the object holds it, m and rad.

    Returns:
        (T, 3) twist of B's origin in B, times its duration, for each piece of `MIN_PIECE` or more;
        of all the path where that is shorter.

    Raises:
        PlanningError: it never moves.
    """
    # pieces that are long enough; the last takes what is left over
    turns = np.abs(np.diff(path[:, 2])) * np.linalg.norm(X_BT[:2])
    way = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(path[:, :2], axis=0), axis=1) + turns))
    if way[-1] <= STILL:
        raise PlanningError("push: the pusher stands still; expected a path")
    kept = [0]
    for i in range(1, len(path)):
        if way[i] - way[kept[-1]] >= MIN_PIECE and way[-1] - way[i] >= MIN_PIECE:
            kept.append(i)
    path = path[[*kept, len(path) - 1]]

    moves = np.diff(path, axis=0)
    middle = (path[1:, 2] + path[:-1, 2]) / 2
    v_T = rotate(-middle, moves[:, :2])
    v = rotate(np.full(len(moves), X_BT[2]), v_T)
    turn = moves[:, 2]
    # the velocity at B's origin, which is -p_BT from that of the pusher's frame
    return np.column_stack([v[:, 0] + turn * X_BT[1], v[:, 1] - turn * X_BT[0], turn])


def calc_stable_probabilities(
    model: Model,
    contacts: PusherContacts,
    twists: ArrayLike,
    *,
    draws: Sequence[CellParameters] | None = None,
) -> Array:
    """Calculates for each twist (T, 3) the fraction of a model's draws by which it is stable, (T,).

    Args:
        model: the object.
        contacts: where the pusher touches it.
        twists: of the object's origin in its own frame, m/s and rad/s.
        draws: of its parameters; `DRAWS` of the model's by default.
    """
    used = model.draws(DRAWS) if draws is None else draws
    cones = [MotionCone(model.obj, params, contacts, model.physics) for params in used]
    return np.asarray(np.mean([cone.contains(twists) for cone in cones], axis=0))


def find_turn_limits(
    model: Model,
    contacts: PusherContacts,
    X_BT: ArrayLike,
    probability: float,
    *,
    max_curvature: float,
    draws: Sequence[CellParameters] | None = None,
) -> tuple[float, float] | None:
    """Finds how tightly the pusher may turn on both hands while the push stays stable.

    The pusher's frame moves along its own x axis and turns about centers on its y axis, as a car
    with its rear axle there.

    Args:
        model: the object.
        contacts: where the pusher touches it.
        X_BT: (3,) pose of the pusher's frame in the body frame, m and rad.
        probability: least probability of a stable push.
        max_curvature: the tightest turn that is tried, 1/m.
        draws: as of `calc_stable_probabilities`.

    Returns:
        The least and the greatest curvature, 1/m, to the right and to the left; all between them
        are stable. None where not even a straight push is.
    """
    frame = check_vector(PlanningError, "X_BT", X_BT, 3)
    require_positive(PlanningError, "", "1/m", max_curvature=max_curvature)
    curvature = list_curvatures(max_curvature)
    twists = calc_turn_twists(frame, curvature)
    stable = calc_stable_probabilities(model, contacts, twists, draws=draws) >= probability
    return find_stable_range(curvature, stable)


def list_curvatures(max_curvature: float) -> Array:
    """Lists the curvatures that are tried, from the tightest turn to the right to the left, 1/m."""
    return np.linspace(-max_curvature, max_curvature, 2 * CURVATURES - 1)


def calc_turn_twists(X_BS: ArrayLike, curvature: ArrayLike) -> Array:
    """Calculates the twists of a body of which a frame S moves as a car, by 1 m.

    Args:
        X_BS: (..., 3) the frame in the body's, m and rad; S moves along its x axis.
        curvature: (C,) of its path, 1/m, positive to the left.

    Returns:
        (..., C, 3) twists of B's origin in B.
    """
    frame = np.asarray(X_BS, dtype=np.float64)[..., None, :]
    k = np.asarray(curvature, dtype=np.float64)
    u = np.cos(frame[..., 2]) + k * frame[..., 1]
    v = np.sin(frame[..., 2]) - k * frame[..., 0]
    return np.stack([u, v, np.broadcast_to(k, u.shape)], axis=-1)


def find_stable_range(curvature: Array, stable: NDArray[np.bool_]) -> tuple[float, float] | None:
    """Finds the range of curvatures about zero that are all stable.

    Args:
        curvature: (C,) as `list_curvatures` lists them.
        stable: (C,) whether the turn is stable.

    Returns:
        The least and the greatest, 1/m; None where not even a straight push is stable.
    """
    straight = len(curvature) // 2
    if not stable[straight]:
        return None
    # the first on each hand that is not stable ends the range
    left = np.flatnonzero(~stable[straight:])
    right = np.flatnonzero(~stable[straight::-1])
    most = straight + (left[0] - 1 if len(left) else straight)
    least = straight - (right[0] - 1 if len(right) else straight)
    return float(curvature[least]), float(curvature[most])
