"""The objects, pushes and logs of pushes whose simulation and learning `bench.speed` times."""

from pathlib import Path

import numpy as np
from shapely import LineString

from gridpush_drake.bench.data.protocol import METERS_PER_PIXEL
from gridpush_drake.bench.pregrasp.experiments import find_mask
from gridpush_drake.dynamics.push import Push, make_path_times, make_times_with
from gridpush_drake.dynamics.push_batch import BatchPush
from gridpush_drake.dynamics.pusher import PusherShape
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import find_shipped_object
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.pushes.push_log import ObservedPush, PushLog

PUSH_DURATION = 2.0
"""Duration of the paper's push, s."""

PUSH_SPEED = 0.1
"""Speed of the paper's push, m/s."""

DISC_RADIUS = 0.015
"""Radius of the disc that pushes in place of the paper's finger, m."""

PAPER_TIME_STEP = 0.01
"""Step of the paper's simulation, s."""

TIP_DISTANCE = 0.04
"""Distance of the centers of two discs that push in the place of one, m."""

CONTACT_FRACTION = 0.7
"""Where along the object's width it is pushed, 0 to 1."""

BAR_OUTLINE = np.array([[0.0, 0.0], [0.22, 0.0], [0.22, 0.055], [0.0, 0.055]])
"""Outline of the object that is identified, m."""

HEAVY_FRACTION = 0.3
"""Fraction of its cells that are heavy, at one end."""

HEAD_LOAD = 5.0
"""Mass of a heavy cell over that of another one."""

BAR_MASS = 0.5
"""Mass of the object, kg."""

BAR_FRICTION = 0.35
"""Friction of the object against the table."""

TIP_FRICTION = 0.3
"""Friction of the object against the pusher."""

POKE_LENGTH = 0.06
"""Length of a poke, m."""

POKE_SPEED = 0.03
"""Speed of a poke, m/s."""

POKE_SLANT = 0.4
"""Greatest angle of a poke from the outline's normal, rad."""

POKE_RADIUS = 0.01
"""Radius of the pusher of a poke, m."""

OBSERVED_POSE_COUNT = 10
"""Number of poses that are seen of each poke."""

POSE_NOISE = (3e-4, 3e-4, 3e-3)
"""Standard deviations of these poses, m, m and rad."""

DRAWN_PUSHES = 100
"""Number of pushes that are simulated with every model that is drawn."""

DRAWN_LENGTH = 0.1
"""Length of these pushes, m."""


def make_bench_push(obj: GridObject) -> Push:
    """Makes the push of the measurement: upwards, from below, off the middle."""
    x0, y0, x1, y1 = obj.outline.bounds
    x = x0 + CONTACT_FRACTION * (x1 - x0)
    bottom = obj.outline.intersection(LineString([(x, y0 - 1), (x, y1 + 1)])).bounds[1]
    return Push((x, bottom - DISC_RADIUS), (0.0, PUSH_SPEED), PUSH_DURATION, DISC_RADIUS)


def make_two_tip_push(obj: GridObject) -> Push:
    """Makes the same push by two discs side by side, of which the nearer one touches first."""
    push = make_bench_push(obj)
    tips = PusherShape.discs([(0.0, -TIP_DISTANCE / 2), (0.0, TIP_DISTANCE / 2)], DISC_RADIUS)
    return Push.along(push.t, push.xy, shape=tips, yaw=np.pi / 2)


def load_hammer(data: Path | None) -> GridObject:
    """Loads the paper's hammer from a folder of masks; the shipped one where that is None."""
    if data is None:
        return GridObject.from_yaml(find_shipped_object("claw_hammer"))
    return GridObject.from_mask(
        find_mask(data), meters_per_pixel=METERS_PER_PIXEL, name="hammer mask"
    )


def make_bench_log(cells: int, pushes: int) -> tuple[GridObject, PushLog]:
    """Makes a bar with a heavy end, of about so many cells, and noisy pokes of it all around."""
    obj = GridObject.from_outline(BAR_OUTLINE, max_cells=cells)
    mass = np.where(obj.p_BC[:, 0] < np.quantile(obj.p_BC[:, 0], HEAVY_FRACTION), HEAD_LOAD, 1.0)
    truth = CellParameters(BAR_MASS * mass / mass.sum(), np.full(obj.n, BAR_FRICTION), TIP_FRICTION)
    rng = np.random.default_rng(0)
    seen = []
    for i in range(pushes):
        place = rng.uniform(0, obj.edges.perimeter)
        angle = rng.uniform(-POKE_SLANT, POKE_SLANT)
        push = Push.on_outline(obj, place, angle, POKE_LENGTH, radius=POKE_RADIUS, speed=POKE_SPEED)
        times = np.linspace(0.0, push.duration, OBSERVED_POSE_COUNT + 1)[1:]
        steps = make_times_with(push, times, "quasi_static")
        motion = simulate(Model(obj, truth), push, regime="quasi_static", times=steps)
        noise = rng.normal(0.0, POSE_NOISE, (OBSERVED_POSE_COUNT, 3))
        poses = motion.poses[np.searchsorted(steps, times)] + noise
        seen.append(ObservedPush(f"poke_{i}", push, np.zeros(3), times, poses))
    return obj, PushLog(tuple(seen))


def draw_random_pushes(obj: GridObject, rng: np.random.Generator) -> list[BatchPush]:
    """Draws the pushes that every drawn model is tried on."""
    pushes = []
    for _ in range(DRAWN_PUSHES):
        place = rng.uniform(0, obj.edges.perimeter)
        angle = rng.uniform(-POKE_SLANT, POKE_SLANT)
        push = Push.on_outline(
            obj, place, angle, DRAWN_LENGTH, radius=POKE_RADIUS, speed=POKE_SPEED
        )
        times = make_path_times(push, "quasi_static")
        last = np.array([len(times) - 1])
        pushes.append(BatchPush(push, np.zeros(3), times, last, None))
    return pushes
