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
from gridpush_drake.errors import GridPushError
from gridpush_drake.files import read_text, write_whole
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.multibody.ground_truth import FEET_SLACK, draw_feet
from gridpush_drake.multibody.mjcf import SINKAGE
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import find_shipped_object
from gridpush_drake.objects.parameters import DEFAULT_TOTAL_MASS, CellParameters
from gridpush_drake.pushes.push_log import DEFAULT_PUSHER_RADIUS, ObservedPush, PushLog

OUTLINES = ("claw_hammer", "combination_wrench", "open_book", "toolbox", "spray_bottle")
"""Shipped objects."""

OWN_WEIGHT, HALF_HEIGHT, FOUNDATION = "own_weight", "half_height", "foundation"
VERTICES, THREE_FEET = "vertices", "three_feet"
KINDS = (OWN_WEIGHT, HALF_HEIGHT, FOUNDATION, VERTICES, THREE_FEET)

MASS_RATIO = (3.0, 10.0)
"""Of a cell of the heavy part to one of the rest; log-uniform."""

FRICTION_RANGE = (0.3, 0.4)
"""What a body's friction, one for all feet, is drawn from; whoever learns knows as much."""

CONTACT_FRICTION_RANGE = (0.35, 0.65)

CONTACT_FRICTION, CONTACT_FRICTION_STD = 0.5, 0.15
"""What is known of it."""

TRAINING, HELD_OUT = 18, 10
"""Pushes of a set."""

DISTANCE, SPEED_RANGE = 0.1, (0.02, 0.05)
"""m and m/s."""

SLANT = np.radians(30)
"""Furthest from the outline's normal."""

CLEARANCE = 5e-4
"""m between pusher and outline at the beginning."""

REACH = 0.1
"""m, at most, of the body from the world's origin at a push's beginning, per axis."""

MIN_MOTION = 0.01
"""m, mean over the cells; pushes that move a body less are drawn again."""

OBSERVATIONS = 10
"""Poses seen during a push, evenly spaced, its end among them."""

UNEVENNESS = 3e-4
"""m, at most, by which a vertex is higher than others."""

FOOT_HEIGHT = 1e-3
"""m of rigid feet: what the flat bottom is above the table. It touches only where feet are over the
edge."""

BEARING_FEET = 3
"""By which a rigid body's weight is shared out, to say how stiff its feet are."""

TRIES = 20000

OBJECT, PUSHES, HELD_OUT_PUSHES, TRUTH = "object.yaml", "pushes.csv", "heldout.csv", "truth.json"
"""Files of a set."""

WHAT = (
    "a truth (JSON with kind, outline, seed, mass, friction, contact_friction, loads, push_height)"
)


@dataclass(frozen=True, eq=False)
class TruthSet:
    """Pushes of one hidden body.

    Attributes:
        kind: of KINDS.
        name: of the outline.
        seed: of all that was drawn.
        obj: as whoever learns sees it: one part, total mass and friction interval.
        params: its true masses and frictions.
        loads: (n,) true loads of its cells at rest, N.
        push_height: of the pusher above the table, m.
        training: pushes to learn from.
        held_out: others.
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
        """p_BBcm (2,), m."""
        return self.params.center_of_mass(self.obj)


def make_set(
    kind: str, name: str, seed: int, training: int = TRAINING, held_out: int = HELD_OUT
) -> TruthSet:
    """Draws a hidden body and pushes it.

    Args:
        kind: of KINDS.
        name: of OUTLINES, or of any shipped object.
        seed: of all that is drawn; masses are the same for every kind.
        training: pushes to learn from.
        held_out: others.

    Returns:
        The set.

    Raises:
        GridPushError: the kind is not known, hardly any push moves the body, or MuJoCo is not
            installed.
        ObjectError: no shipped object has this name.
    """
    rng = np.random.default_rng([seed, crc32(name.encode())])
    obj, params = draw_masses(name, rng)
    body = make_body(kind, obj, params, rng)
    radius = obj.prior.pusher_radius or DEFAULT_PUSHER_RADIUS
    obj = replace(
        obj, prior=replace(obj.prior, pusher_radius=radius, push_height=body.push_height or None)
    )
    world = MujocoWorld(body, radius, observations=OBSERVATIONS)
    pushes = [draw_push(world, f"push_{i + 1}", rng) for i in range(training + held_out)]
    logs = (PushLog(tuple(pushes[:training])), PushLog(tuple(pushes[training:])))
    return TruthSet(kind, name, seed, obj, params, world.loads, body.push_height, *logs)


def draw_masses(name: str, rng: np.random.Generator) -> tuple[GridObject, CellParameters]:
    """Draws what a shipped object's parts weigh, one of them heavy, and how it rubs; gives it as if unknown, too."""
    shipped = GridObject.from_yaml(find_shipped_object(name))
    heavy, ratio = rng.choice(np.unique(shipped.labels)), np.exp(rng.uniform(*np.log(MASS_RATIO)))
    low, high = FRICTION_RANGE
    prior = replace(
        shipped.prior, friction=(low + high) / 2, friction_min=low, friction_max=high,
        contact_friction=CONTACT_FRICTION, contact_friction_std=CONTACT_FRICTION_STD,
    )  # fmt: skip
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
) -> TruthBody:
    """Puts an object of given masses on feet, pushed at a height, m; OWN_WEIGHT at the table's.

    Raises:
        GridPushError: the kind is not known.
        ObjectError: no three feet are found that bear it while it is pushed.
    """
    cells, weight = np.arange(obj.n), params.total_mass * GRAVITY
    height = 0.0 if kind == OWN_WEIGHT else height
    if kind in (OWN_WEIGHT, HALF_HEIGHT):
        return TruthBody(
            obj, params, obj.p_BC, cells, params.mass * GRAVITY, SINKAGE, np.zeros(obj.n), height
        )
    if kind == FOUNDATION:
        even = np.full(obj.n, weight / obj.n)
        return TruthBody(obj, params, obj.p_BC, cells, even, SINKAGE, np.zeros(obj.n), height)
    rim = shapely.get_coordinates(obj.outline.convex_hull)[:-1]
    rim_cell = np.linalg.norm(rim[:, None] - obj.p_BC, axis=2).argmin(axis=1)
    if kind == VERTICES:
        feet, cell, gap = rim, rim_cell, rng.uniform(0, UNEVENNESS, len(rim))
    elif kind == THREE_FEET:
        three = draw_feet(obj, params, float(params.friction.max()) * height + FEET_SLACK, rng)
        feet, cell = np.concatenate([obj.p_BC[three], rim]), np.concatenate([three, rim_cell])
        gap = np.concatenate([np.zeros(len(three)), np.full(len(rim), FOOT_HEIGHT)])
    else:
        raise GridPushError(f"kind: {kind!r}; expected one of {', '.join(KINDS)}")
    load = np.full(len(feet), weight / BEARING_FEET)
    return TruthBody(
        obj,
        params,
        feet,
        cell,
        load,
        RIGID_SINKAGE,
        gap,
        height,
        bottom=FOOT_HEIGHT,
        time_step=RIGID_TIME_STEP,
    )


def draw_push(world: MujocoWorld, name: str, rng: np.random.Generator) -> ObservedPush:
    """Draws a pose of a world's body and a push that moves it, and makes the push.

    Raises:
        GridPushError: none of TRIES random pushes moves the body by MIN_MOTION.
    """
    obj = world.body.obj
    radius = world.radius
    for _ in range(TRIES):
        pose = np.array([*rng.uniform(-REACH, REACH, 2), rng.uniform(-np.pi, np.pi)])
        place = rng.uniform(0, obj.edges.perimeter)
        angle = rng.uniform(-SLANT, SLANT)
        speed = rng.uniform(*SPEED_RANGE)
        point, _, normal = obj.edges.at(place)
        # In a notch the pusher may not reach the place without touching another one.
        if obj.outline.distance(Point(point + normal * (radius + CLEARANCE))) < radius:
            continue
        push = Push.on_outline(
            obj, place, angle, DISTANCE, radius=radius, speed=speed, pose=pose, clearance=CLEARANCE
        )
        world.put(pose)
        seen = world.execute(push)
        motion = world.truth.motion
        assert motion is not None
        begin, end = obj.cells_at(motion.poses[[0, -1]])
        if np.linalg.norm(end - begin, axis=1).mean() >= MIN_MOTION:
            return replace(seen, name=name, pose=motion.poses[0])
    raise GridPushError(f"{obj.name}: none of {TRIES} random pushes moves it by {MIN_MOTION:g} m")


def write_set(made: TruthSet, folder: Path, force: bool = False) -> None:
    """Writes object.yaml, pushes.csv, heldout.csv, truth.json. Raises OutputError where one may not be written."""
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
    made.obj.write_yaml(folder / OBJECT, force)
    made.training.write_csv(folder / PUSHES, force)
    made.held_out.write_csv(folder / HELD_OUT_PUSHES, force)
    write_whole(folder / TRUTH, json.dumps(truth, indent=1) + "\n", force)


def read_set(folder: Path) -> TruthSet:
    """Reads what `write_set` wrote.

    Args:
        folder: of the set.

    Returns:
        The set.

    Raises:
        GridPushError: a file is not there or not of its form.
    """
    obj = GridObject.from_yaml(folder / OBJECT)
    logs = [
        PushLog.read_csv(folder / name, obj.prior.pusher_radius)
        for name in (PUSHES, HELD_OUT_PUSHES)
    ]
    path = folder / TRUTH
    try:
        truth = json.loads(read_text(path, WHAT, GridPushError))
        params = CellParameters(truth["mass"], truth["friction"], truth["contact_friction"])
        loads = np.array(truth["loads"], dtype=np.float64)
        height = float(truth["push_height"])
        if not params.n == len(loads) == obj.n:
            raise ValueError(f"{params.n} masses and {len(loads)} loads of {obj.n} cells")
        kind, name, seed = str(truth["kind"]), str(truth["outline"]), int(truth["seed"])
    except (ValueError, KeyError, TypeError) as error:
        raise GridPushError(f"{path}: expected {WHAT} ({error!r})") from error
    return TruthSet(kind, name, seed, obj, params, loads, height, *logs)
