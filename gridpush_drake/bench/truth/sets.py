"""Sets of pushes of hidden bodies that do not obey the model: drawn by seed, written and read."""

import json
from dataclasses import dataclass, replace
from pathlib import Path
from zlib import crc32

import numpy as np
import shapely
from shapely import Point

from gridpush_drake.bench.truth.mujoco_world import (
    BODY_HEIGHT,
    RIGID_SINKAGE,
    RIGID_TIME_STEP,
    MujocoWorld,
    TruthBody,
)
from gridpush_drake.dynamics.physics import GRAVITY
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.pusher import DEFAULT_PUSHER_RADIUS
from gridpush_drake.errors import GridPushError
from gridpush_drake.files import read_text, write_whole
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.model import Model
from gridpush_drake.multibody.ground_truth import FEET_SLACK, draw_feet
from gridpush_drake.multibody.mjcf import FOUNDATION_SINKAGE
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import OBJECT_FILE, find_shipped_object
from gridpush_drake.objects.parameters import DEFAULT_TOTAL_MASS, CellParameters
from gridpush_drake.pushes.push_csv import PUSHES_FILE
from gridpush_drake.pushes.push_log import ObservedPush, PushLog

OUTLINE_NAMES = ("claw_hammer", "combination_wrench", "open_book", "toolbox", "spray_bottle")
"""Shipped objects."""

OWN_WEIGHT = "own_weight"
"""Kind of a body of which each cell bears its own weight."""

HALF_HEIGHT = "half_height"
"""Kind of such a body that is pushed at half its height."""

FOUNDATION_KIND = "foundation"
"""Kind of a body with an evenly compliant bottom."""

VERTICES_KIND = "vertices"
"""Kind of a body that stands on uneven rigid feet at the vertices of its hull."""

THREE_FEET = "three_feet"
"""Kind of a body that stands on three rigid feet."""

FLAT_KIND = "flat"
"""Kind of a rigid body whose bottom is flat: it bears at the vertices of its hull, which all end at
one height, and at the table's edge. It is for presses at that edge only."""

TRUTH_KINDS = (OWN_WEIGHT, HALF_HEIGHT, FOUNDATION_KIND, VERTICES_KIND, THREE_FEET)
"""Kinds of truth; see `bench.truth.mujoco_world`."""

MASS_RATIO = (3.0, 10.0)
"""Least and greatest mass of a cell of the heavy part over one of the rest; its logarithm is drawn
evenly."""

FRICTION_RANGE = (0.3, 0.4)
"""Least and greatest friction of a body, one for all feet; whoever learns knows as much."""

CONTACT_FRICTION_RANGE = (0.35, 0.65)
"""Least and greatest friction of the pusher on a body."""

CONTACT_FRICTION = 0.5
"""Friction of the pusher on a body as it is believed beforehand."""

CONTACT_FRICTION_STD = 0.15
"""Standard deviation of that belief."""

TRAINING_PUSH_COUNT = 18
"""Number of pushes of a set to learn from."""

HELD_OUT = 10
"""Number of pushes of a set that are held out."""

PUSH_LENGTH = 0.1
"""Length of a push, m."""

SPEED_RANGE = (0.02, 0.05)
"""Least and greatest speed of the pusher, m/s."""

MAX_PUSH_ANGLE = np.radians(30)
"""Greatest angle of a push from the outline's inward normal, rad."""

PUSHER_CLEARANCE = 5e-4
"""Distance of the pusher from the outline when a push begins, m."""

MAX_BODY_OFFSET = 0.1
"""Greatest distance of the body from the world's origin when a push begins, per axis, m."""

MIN_MOTION = 0.01
"""Mean distance that a push must move the cells, m; pushes that move them less are drawn again."""

OBSERVATION_COUNT = 10
"""Number of poses that are seen during a push, evenly spaced, its end among them."""

MAX_UNEVENNESS = 3e-4
"""Greatest height of a vertex above the lowest one, m."""

FOOT_HEIGHT = 1e-3
"""Height of the flat bottom of a body on rigid feet above the table, m. It touches only where feet
are over the edge."""

BEARING_FEET = 3
"""Number of feet that share a rigid body's weight, which says how stiff its feet are."""

MAX_PUSH_TRIES = 20000
"""Number of random pushes that are tried before it is said that none moves the body."""

HELD_OUT_PUSHES = "heldout.csv"
"""File of a set that has the pushes that are held out."""

DESIGNED_PUSHES = "designed.csv"
"""File of a set that has pushes chosen by what tells most; see `bench.truth.design`."""

TRUTH_FILE = "truth.json"
"""File of a set that has the truth."""

EXPECTED_TRUTH = (
    "a truth (JSON with kind, outline, seed, mass, friction, contact_friction, loads, push_height)"
)
"""What TRUTH_FILE should hold, for errors."""


@dataclass(frozen=True, eq=False)
class TruthSet:
    """Pushes of one hidden body.

    Attributes:
        kind: one of TRUTH_KINDS.
        name: name of the outline.
        seed: seed of all that was drawn.
        obj: the object as whoever learns sees it: one part, total mass and bounds of its friction.
        params: its true masses and frictions.
        loads: (n,) true loads of its cells at rest, N.
        push_height: height of the pusher above the table, m.
        training: pushes to learn from.
        held_out: pushes that are held out.
    """

    kind: str
    name: str
    seed: int
    obj: GridObject
    params: CellParameters
    loads: Array
    push_height: float
    training: PushLog
    held_out: PushLog

    @property
    def center_of_mass(self) -> Array:
        """The true center of mass p_BBcm (2,), m."""
        return self.params.center_of_mass(self.obj)


def make_set(
    kind: str, name: str, seed: int, training: int = TRAINING_PUSH_COUNT, held_out: int = HELD_OUT
) -> TruthSet:
    """Draws a hidden body and pushes it.

    Args:
        kind: one of TRUTH_KINDS.
        name: name of a shipped object.
        seed: seed of all that is drawn; masses are the same for every kind.
        training: number of pushes to learn from.
        held_out: number of pushes that are held out.

    Returns:
        The set.

    Raises:
        GridPushError: the kind is not known, hardly any push moves the body, or MuJoCo is not
            installed.
        ObjectError: no shipped object has this name.
    """
    obj, world, rng = draw_world(kind, name, seed)
    pushes = [draw_push(world, f"push_{i + 1}", rng) for i in range(training + held_out)]
    return TruthSet(
        kind=kind,
        name=name,
        seed=seed,
        obj=obj,
        params=world.bodies.params,
        loads=world.loads,
        push_height=world.body.push_height,
        training=PushLog(tuple(pushes[:training])),
        held_out=PushLog(tuple(pushes[training:])),
    )


def draw_world(
    kind: str, name: str, seed: int
) -> tuple[GridObject, MujocoWorld, np.random.Generator]:
    """Draws a hidden body, and puts it on a table without edges.

    Args:
        kind: one of TRUTH_KINDS.
        name: name of a shipped object.
        seed: seed of all that is drawn; masses are the same for every kind.

    Returns:
        The object as whoever learns sees it, the world in which the body is pushed, and the
        generator that drew the body and is to draw its pushes.

    Raises:
        GridPushError: the kind is not known, or MuJoCo is not installed.
        ObjectError: no shipped object has this name.
    """
    rng = np.random.default_rng([seed, crc32(name.encode())])
    obj, params = draw_masses(name, rng)
    body = make_body(kind, obj, params, rng)
    radius = obj.prior.pusher_radius or DEFAULT_PUSHER_RADIUS
    known_prior = replace(obj.prior, pusher_radius=radius, push_height=body.push_height or None)
    world = MujocoWorld(body, radius, observations=OBSERVATION_COUNT)
    return replace(obj, prior=known_prior), world, rng


def draw_masses(name: str, rng: np.random.Generator) -> tuple[GridObject, CellParameters]:
    """Draws what a shipped object's parts weigh, one of them heavy, and how it rubs.

    Returns:
        The object as whoever learns sees it, and its true masses and frictions.
    """
    shipped = GridObject.from_yaml(find_shipped_object(name))
    heavy = rng.choice(np.unique(shipped.labels))
    ratio = np.exp(rng.uniform(*np.log(MASS_RATIO)))
    low, high = FRICTION_RANGE
    prior = replace(
        shipped.prior,
        friction=(low + high) / 2,
        friction_min=low,
        friction_max=high,
        contact_friction=CONTACT_FRICTION,
        contact_friction_std=CONTACT_FRICTION_STD,
    )
    obj = replace(shipped, labels=np.ones(shipped.n, dtype=np.int64), prior=prior)
    mass = np.where(shipped.labels == heavy, ratio, 1.0)
    mass *= (prior.total_mass or DEFAULT_TOTAL_MASS) / mass.sum()
    friction = np.full(obj.n, rng.uniform(*FRICTION_RANGE))
    return obj, CellParameters(mass, friction, rng.uniform(*CONTACT_FRICTION_RANGE))


def make_body(
    kind: str,
    obj: GridObject,
    params: CellParameters,
    rng: np.random.Generator,
    height: float = BODY_HEIGHT / 2,
    rim_gap: float = FOOT_HEIGHT,
) -> TruthBody:
    """Puts an object of given masses on feet.

    Args:
        kind: one of TRUTH_KINDS, or FLAT.
        obj: the object.
        params: its masses and frictions.
        rng: draws what is random about the feet.
        height: height at which it is pushed, m; an OWN_WEIGHT is pushed at the table's height.
        rim_gap: height of the underside of a body on rigid feet above the table, m. Those at the
            vertices are uneven by as much, but by no more than MAX_UNEVENNESS.

    Raises:
        GridPushError: the kind is not known.
        ObjectError: no three feet are found that bear it while it is pushed.
    """
    weight = params.total_mass * GRAVITY
    soft = TruthBody(
        obj=obj,
        params=params,
        feet=obj.p_BC,
        cell=np.arange(obj.n),
        load=params.mass * GRAVITY,
        sinkage=FOUNDATION_SINKAGE,
        gap=np.zeros(obj.n),
        push_height=0.0 if kind == OWN_WEIGHT else height,
    )
    if kind in (OWN_WEIGHT, HALF_HEIGHT):
        return soft
    if kind == FOUNDATION_KIND:
        return replace(soft, load=np.full(obj.n, weight / obj.n))

    # Rigid feet, at the vertices of the hull too: there they end above the table, and touch it only
    # where the body tips.
    rim = shapely.get_coordinates(obj.outline.convex_hull)[:-1]
    rim_cell = np.linalg.norm(rim[:, None] - obj.p_BC, axis=2).argmin(axis=1)
    if kind == VERTICES_KIND:
        feet = rim
        cell = rim_cell
        gap = rng.uniform(0, min(MAX_UNEVENNESS, rim_gap), len(rim))
    elif kind == THREE_FEET:
        three = draw_feet(
            Model(obj, params), float(params.friction.max()) * height + FEET_SLACK, rng
        )
        feet = np.concatenate([obj.p_BC[three], rim])
        cell = np.concatenate([three, rim_cell])
        gap = np.concatenate([np.zeros(len(three)), np.full(len(rim), rim_gap)])
    elif kind == FLAT_KIND:
        feet = rim
        cell = rim_cell
        gap = np.zeros(len(rim))
        rim_gap = 0.0
    else:
        raise GridPushError(
            f"kind: {kind!r}; expected one of {', '.join((*TRUTH_KINDS, FLAT_KIND))}"
        )
    return replace(
        soft,
        feet=feet,
        cell=cell,
        load=np.full(len(feet), weight / BEARING_FEET),
        sinkage=RIGID_SINKAGE,
        gap=gap,
        bottom=rim_gap,
        time_step=RIGID_TIME_STEP,
    )


def draw_push(world: MujocoWorld, name: str, rng: np.random.Generator) -> ObservedPush:
    """Draws a pose of a world's body and a push that moves it, and makes the push.

    Raises:
        GridPushError: none of MAX_PUSH_TRIES random pushes moves the body by MIN_MOTION.
    """
    obj = world.body.obj
    radius = world.radius
    for _ in range(MAX_PUSH_TRIES):
        pose = np.array(
            [*rng.uniform(-MAX_BODY_OFFSET, MAX_BODY_OFFSET, 2), rng.uniform(-np.pi, np.pi)]
        )
        place = rng.uniform(0, obj.edges.perimeter)
        angle = rng.uniform(-MAX_PUSH_ANGLE, MAX_PUSH_ANGLE)
        speed = rng.uniform(*SPEED_RANGE)
        point, _, normal = obj.edges.at(place)
        # In a notch the pusher may not reach the place without touching another one.
        if obj.outline.distance(Point(point + normal * (radius + PUSHER_CLEARANCE))) < radius:
            continue
        push = Push.on_outline(
            obj,
            place,
            angle,
            PUSH_LENGTH,
            radius=radius,
            speed=speed,
            pose=pose,
            clearance=PUSHER_CLEARANCE,
        )
        world.put(pose)
        seen = world.execute(push)
        motion = world.truth.motion
        assert motion is not None
        begin, end = obj.cells_at(motion.poses[[0, -1]])
        if np.linalg.norm(end - begin, axis=1).mean() >= MIN_MOTION:
            return replace(seen, name=name, pose=motion.poses[0])
    raise GridPushError(
        f"{obj.name}: none of {MAX_PUSH_TRIES} random pushes moves it by {MIN_MOTION:g} m"
    )


def write_set(made: TruthSet, folder: Path, force: bool = False) -> None:
    """Writes object.yaml, pushes.csv, heldout.csv and truth.json.

    Args:
        made: the set.
        folder: where they are written.
        force: whether files that exist may be replaced.

    Raises:
        OutputError: one may not be written.
    """
    params = made.params
    truth = {
        "kind": made.kind,
        "outline": made.name,
        "seed": made.seed,
        "center_of_mass": made.center_of_mass.tolist(),
        "loads": made.loads.tolist(),
        "mass": params.mass.tolist(),
        "friction": params.friction.tolist(),
        "contact_friction": params.contact_friction,
        "push_height": made.push_height,
        "object_height": BODY_HEIGHT,
    }
    folder.mkdir(parents=True, exist_ok=True)
    made.obj.write_yaml(folder / OBJECT_FILE, force)
    made.training.write_csv(folder / PUSHES_FILE, force)
    made.held_out.write_csv(folder / HELD_OUT_PUSHES, force)
    write_whole(folder / TRUTH_FILE, json.dumps(truth, indent=1) + "\n", force)


def read_set(folder: Path) -> TruthSet:
    """Reads what `write_set` wrote.

    Args:
        folder: folder of the set.

    Returns:
        The set.

    Raises:
        GridPushError: a file is not there or not of its form.
    """
    obj = GridObject.from_yaml(folder / OBJECT_FILE)
    logs = [
        PushLog.read_csv(folder / name, obj.prior.pusher_radius)
        for name in (PUSHES_FILE, HELD_OUT_PUSHES)
    ]
    path = folder / TRUTH_FILE
    try:
        truth = json.loads(read_text(path, EXPECTED_TRUTH, GridPushError))
        params = CellParameters(truth["mass"], truth["friction"], truth["contact_friction"])
        loads = np.array(truth["loads"], dtype=np.float64)
        height = float(truth["push_height"])
        if not params.n == len(loads) == obj.n:
            raise ValueError(f"{params.n} masses and {len(loads)} loads of {obj.n} cells")
        kind = str(truth["kind"])
        name = str(truth["outline"])
        seed = int(truth["seed"])
    except (ValueError, KeyError, TypeError) as error:
        raise GridPushError(f"{path}: expected {EXPECTED_TRUTH} ({error!r})") from error
    return TruthSet(
        kind=kind,
        name=name,
        seed=seed,
        obj=obj,
        params=params,
        loads=loads,
        push_height=height,
        training=logs[0],
        held_out=logs[1],
    )
