"""Worlds of `bench.steering.experiments`: hidden bodies, pokes, and steered fingers."""

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike
from shapely import Point

from gridpush_drake.bench.truth.mujoco_world import MujocoWorld, TruthBody
from gridpush_drake.bench.truth.sets import FOUNDATION_KIND, THREE_FEET, draw_masses, make_body
from gridpush_drake.dynamics.push import Push
from gridpush_drake.errors import GridPushError
from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.result import Identification
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.feedback.steered_finger import (
    PoseSensorModel,
    SteeredFinger,
)
from gridpush_drake.planning.pushed_object import FeedbackFinger
from gridpush_drake.planning.world import SimulatedWorld, TrackedWorld
from gridpush_drake.pushes.push_log import ObservedPush, PushLog

LCP_WORLD = "lcp"
"""Name of the world that obeys the model."""

STEERED_WORLDS = (LCP_WORLD, FOUNDATION_KIND, THREE_FEET)
"""Names of the worlds; all but the first are kinds of bodies in MuJoCo, see `bench.truth.sets`."""

STEERED_FINGER = FeedbackFinger(radius=0.008, speed=0.1, walking_speed=0.2)
"""The finger."""

POSE_SENSOR = PoseSensorModel(
    period=0.02, delay=0.1, missing=0.1, position_std=0.0005, angle_std=0.003
)
"""How the object is seen."""

POKE_COUNT = 3
"""Pokes that are learned from."""

POKE_LENGTH = 0.1
"""Length of a poke, m."""

POKE_SPEED = 0.04
"""Speed of a poke, m/s."""

MAX_POKE_ANGLE = np.radians(30)
"""Greatest angle of a poke from the outline's inward normal, rad."""

LEAST_MOTION = 0.01
"""Mean distance that a poke must move the cells, m."""

MAX_POKE_TRIES = 200
"""Random pokes that are tried for one that moves the object."""


class FingerMaker(Protocol):
    """Makes a world with the hidden body, and a finger that is steered there."""

    def __call__(self, pose: ArrayLike, tip: ArrayLike, finger: FeedbackFinger) -> SteeredFinger:
        """Puts the object down at a pose (3,), and the finger at a place (2,).

        A finger that is no disc is put down at (3,), with its angle, rad.
        """
        ...


@dataclass(frozen=True, eq=False)
class HiddenBodyCase:
    """A hidden body, and what was learned of it.

    Attributes:
        obj: the object, as whoever learns sees it.
        truth: its true masses and frictions.
        learned: what was learned from the pokes; None where it was not asked for.
        make_finger: makes the world, and the finger in it.
        pokes: what it was learned from; None where it was not learned.
        body: the body in MuJoCo; None where the world obeys the model.
    """

    obj: GridObject
    truth: CellParameters
    learned: Identification | None
    make_finger: FingerMaker
    pokes: PushLog | None = None
    body: TruthBody | None = None


def make_case(
    world: str, name: str, seed: int, *, learns: bool, poke_count: int = POKE_COUNT
) -> HiddenBodyCase:
    """Draws a body, and learns it from pokes where that is asked for.

    Args:
        world: LCP_WORLD, or a kind of bodies in MuJoCo, see `bench.truth.sets`.
        name: name of a shipped object.
        seed: of everything.
        learns: whether the body is poked and learned.
        poke_count: number of pokes.
    """
    rng = np.random.default_rng((seed, 51))
    obj, truth = draw_masses(name, rng)
    pokes_world, make_finger = put_body(world, obj, truth, rng, seed)
    learned = None
    pokes = None
    if learns:
        pokes = PushLog(tuple(draw_poke(pokes_world, obj, rng, i) for i in range(poke_count)))
        learned = identify(Model(obj), pokes, seed=seed, regime="quasi_static")
    body = pokes_world.body if isinstance(pokes_world, MujocoWorld) else None
    return HiddenBodyCase(
        obj=obj, truth=truth, learned=learned, make_finger=make_finger, pokes=pokes, body=body
    )


def put_body(
    world: str, obj: GridObject, truth: CellParameters, rng: np.random.Generator, seed: int
) -> tuple[TrackedWorld, FingerMaker]:
    """Puts a body of given masses into a world.

    Args:
        world: one of STEERED_WORLDS.
        obj: the object.
        truth: its masses and frictions.
        rng: draws what is random about its feet.
        seed: of the noise of what is seen.

    Returns:
        A world in which the body is poked, and what makes a world with a finger that is steered.
    """
    pokes_world: TrackedWorld
    if world == LCP_WORLD:
        pokes_world = SimulatedWorld(
            Model(obj, truth),
            np.zeros(3),
            position_std=POSE_SENSOR.position_std,
            angle_std=POSE_SENSOR.angle_std,
            seed=seed,
        )

        def make_finger(pose: ArrayLike, tip: ArrayLike, finger: FeedbackFinger) -> SteeredFinger:
            world = SimulatedWorld(Model(obj, truth), pose)
            return SteeredFinger(world, tip, finger.radius, POSE_SENSOR, seed, shape=finger.shape)

    else:
        body = make_body(world, obj, truth, rng)
        pokes_world = MujocoWorld(
            body,
            STEERED_FINGER.radius,
            position_std=POSE_SENSOR.position_std,
            angle_std=POSE_SENSOR.angle_std,
            seed=seed,
        )

        def make_finger(pose: ArrayLike, tip: ArrayLike, finger: FeedbackFinger) -> SteeredFinger:
            world = MujocoWorld(body, finger.shape or finger.radius, pose=pose)
            return SteeredFinger(world, tip, finger.radius, POSE_SENSOR, seed, shape=finger.shape)

    return pokes_world, make_finger


def draw_poke(
    world: TrackedWorld, obj: GridObject, rng: np.random.Generator, number: int
) -> ObservedPush:
    """Pokes an object at random until a poke moves it.

    Raises:
        GridPushError: none of MAX_POKE_TRIES pokes does.
    """
    for _ in range(MAX_POKE_TRIES):
        pose = np.array([0.0, 0.0, rng.uniform(-np.pi, np.pi)])
        place = rng.uniform(0, obj.edges.perimeter)
        angle = rng.uniform(-MAX_POKE_ANGLE, MAX_POKE_ANGLE)
        point, _, normal = obj.edges.at(place)
        # in a notch the finger may not reach the place without touching another one
        if (
            obj.outline.distance(Point(point + normal * (STEERED_FINGER.radius + 1e-4)))
            < STEERED_FINGER.radius
        ):
            continue
        world.put(pose)
        push = Push.on_outline(
            obj,
            place,
            angle,
            POKE_LENGTH,
            radius=STEERED_FINGER.radius,
            speed=POKE_SPEED,
            pose=pose,
            clearance=1e-4,
        )
        seen = world.execute(push)
        motion = world.truth.motion
        assert motion is not None
        begin, end = obj.cells_at(motion.poses[[0, -1]])
        if np.linalg.norm(end - begin, axis=1).mean() >= LEAST_MOTION:
            return replace(seen, name=f"poke_{number + 1}")
    raise GridPushError(f"{obj.name}: none of {MAX_POKE_TRIES} random pokes moves it")
