"""What the doors to JAX and torch share: arrays in, poses and exact derivatives out.

The arrays may have any leading dimensions, which broadcast.

A straight push of a disc is a function of six arguments, `ARGUMENT_NAMES`. Its derivatives are the
named blocks of `Motion.jacobian`; only those by the pusher's velocity are put together here. With
the velocity v = L/T (cos a, sin a) of a push that lasts T,

    dq = q_a da + q_L dL,     da = (-sin a, cos a) dv / |v|,     dL = T (cos a, sin a) dv
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from gridpush_drake.dynamics.motion import Jacobian
from gridpush_drake.dynamics.physics import Physics
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.pusher import DEFAULT_PUSHER_RADIUS
from gridpush_drake.dynamics.simulation import simulate_batch
from gridpush_drake.errors import SimulationError
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters

ARGUMENT_NAMES = ("mass", "friction", "contact_friction", "start", "velocity", "pose")
"""The differentiable arguments, in the order in which all functions here take them."""

POSE_SIZE = 3
"""Numbers of a pose in the plane."""


@dataclass(frozen=True)
class PushSetting:
    """All of a push that is not differentiated.

    Attributes:
        duration: of the push, s.
        radius: of the pusher's disc, m; None for the object's own (`prior.pusher_radius`), or the
            default of push logs.
        steps: number of time steps; None for the simulator's own, which depends on the length of
            the push. Where the length is optimized, a number keeps the function smooth.
        path: whether all poses are returned, the first included, or only the last one; needs
            `steps`.
        physics: friction law, regime, spin and gravity; None for the default ones.
        table: (K, 2) corners of the table's top in W, m, as nested tuples; None where it is
            endless.
        push_height: height at which the pusher acts, m, see `CellParameters`; not differentiated.

    Raises:
        SimulationError: `path` is asked for without `steps`, or a number is out of range.
    """

    duration: float
    radius: float | None = None
    steps: int | None = None
    path: bool = False
    physics: Physics | None = None
    table: tuple[tuple[float, float], ...] | None = None
    push_height: float = 0.0

    def __post_init__(self) -> None:
        if not (np.isfinite(self.duration) and self.duration > 0):
            raise SimulationError(f"duration is {self.duration!r}; expected a positive number (s)")
        if self.steps is not None and not self.steps >= 1:
            raise SimulationError(f"steps is {self.steps!r}; expected 1 or more")
        if self.path and self.steps is None:
            raise SimulationError("path: all poses are asked for; expected a number of steps, too")

    @property
    def rows(self) -> int:
        """Number of poses that are returned."""
        return 1 if not self.path or self.steps is None else self.steps + 1


class PushFunction:
    """A push of an object as a function of arrays, with derivatives.

    Attributes:
        obj: the object.
        setting: what is not differentiated.
        shapes: shape of each argument in `ARGUMENT_NAMES`, without leading dimensions.
    """

    def __init__(self, obj: GridObject, setting: PushSetting) -> None:
        """Makes the function."""
        self.obj = obj
        self.setting = setting
        self.shapes = ((obj.n,), (obj.n,), (), (2,), (2,), (POSE_SIZE,))
        radius = obj.prior.pusher_radius if setting.radius is None else setting.radius
        self._radius = DEFAULT_PUSHER_RADIUS if radius is None else radius

    @property
    def output_shape(self) -> tuple[int, ...]:
        """Shape of the result, without leading dimensions: (3,), or (steps + 1, 3)."""
        return (self.setting.rows, POSE_SIZE) if self.setting.path else (POSE_SIZE,)

    def fill_defaults(self, values: Sequence[ArrayLike | None]) -> list[ArrayLike]:
        """Puts the object's prior in the place of arguments that are None, and a pose of zeros."""
        obj = self.obj
        uniform = CellParameters.uniform(obj)
        defaults = (
            uniform.mass,
            uniform.friction,
            uniform.contact_friction,
            None,
            None,
            np.zeros(POSE_SIZE),
        )
        filled: list[ArrayLike] = []
        for name, value, default in zip(ARGUMENT_NAMES, values, defaults, strict=True):
            chosen = default if value is None else value
            if chosen is None:
                raise SimulationError(f"{name} is missing; expected an array")
            filled.append(chosen)
        return filled

    def check_shapes(self, shapes: Sequence[tuple[int, ...]]) -> None:
        """Raises SimulationError where an argument's last dimensions are not as they should be."""
        for name, shape, wanted in zip(ARGUMENT_NAMES, shapes, self.shapes, strict=True):
            if len(shape) < len(wanted) or shape[len(shape) - len(wanted) :] != wanted:
                raise SimulationError(f"{name} has shape {shape}; expected (..., {wanted})")

    def calc_poses(self, *values: ArrayLike) -> Array:
        """The poses, (..., 3) or (..., steps + 1, 3), of arguments with any leading dimensions."""
        arrays, leading = self._broadcast(values)
        poses, _ = self._run(arrays, derive=False)
        return poses.reshape(leading + self.output_shape)

    def differentiate(self, *values: ArrayLike) -> tuple[Array, list[Array]]:
        """The poses, and their derivatives by each argument.

        Returns:
            The poses as `calc_poses` has them, and for each argument an array whose last dimensions
            are those of the result followed by those of the argument.
        """
        arrays, leading = self._broadcast(values)
        poses, blocks = self._run(arrays, derive=True)
        return poses.reshape(leading + self.output_shape), [
            block.reshape(leading + self.output_shape + shape)
            for block, shape in zip(blocks, self.shapes, strict=True)
        ]

    def _broadcast(self, values: Sequence[ArrayLike]) -> tuple[list[Array], tuple[int, ...]]:
        """The arguments as (B, ...) each, and the leading dimensions, whose product is B."""
        given = [np.asarray(value, dtype=np.float64) for value in values]
        # What stands before an argument's own dimensions are the leading ones of a batch.
        self.check_shapes([value.shape for value in given])
        own = [
            value.shape[: value.ndim - len(shape)]
            for value, shape in zip(given, self.shapes, strict=True)
        ]
        leading = np.broadcast_shapes(*own)
        return [
            np.broadcast_to(value, leading + shape).reshape((-1, *shape))
            for value, shape in zip(given, self.shapes, strict=True)
        ], leading

    def _run(self, arrays: list[Array], derive: bool) -> tuple[Array, list[Array]]:
        """Simulates B pushes: poses (B, R, 3), and blocks (B, R, 3, ...) if they are wanted."""
        mass, friction, contact_friction, start, velocity, pose = arrays
        setting = self.setting
        count = len(mass)
        if not count:
            return np.empty((0, setting.rows, POSE_SIZE)), [
                np.empty((0, setting.rows, POSE_SIZE, *shape)) for shape in self.shapes
            ]
        if not np.linalg.norm(velocity, axis=1).all():
            raise SimulationError("velocity is (0, 0) in a push; expected a pusher that moves")
        params = [
            CellParameters(mass[i], friction[i], float(contact_friction[i]), setting.push_height)
            for i in range(count)
        ]
        pushes = [Push(start[i], velocity[i], setting.duration, self._radius) for i in range(count)]
        times = None
        if setting.steps is not None:
            times = np.linspace(0.0, setting.duration, setting.steps + 1)

        # Every push by itself, on all cores; the result does not depend on their number.
        motions = simulate_batch(
            [Model(self.obj, each, setting.physics) for each in params],
            pushes,
            pose,
            gradients=derive,
            record=None if setting.path else [-1],
            times=times,
            table=setting.table,
        )
        poses = np.array([motion.poses for motion in motions])
        if not setting.path:
            poses = poses[:, -1:]
        if not derive:
            return poses, []

        # The named blocks of each motion, in the order of `ARGUMENT_NAMES`.
        blocks: list[list[Array]] = [[] for _ in ARGUMENT_NAMES]
        for motion, pushed in zip(motions, velocity, strict=True):
            found = motion.jacobian
            moved = calc_velocity_block(found, pushed, setting.duration)
            of_motion = (
                found.mass,
                found.friction,
                found.contact_friction,
                found.start,
                moved,
                found.pose,
            )
            for block, rows in zip(blocks, of_motion, strict=True):
                block.append(rows)
        return poses, [np.array(block) for block in blocks]


def calc_velocity_block(jacobian: Jacobian, velocity: Array, duration: float) -> Array:
    """Derivatives (R, 3, 2) of poses by the velocity (2,) of a push that lasts `duration`, s."""
    # The two directions in which a velocity changes: it grows, and it turns.
    speed = np.linalg.norm(velocity)
    along = velocity / speed
    across = np.array([-along[1], along[0]])
    turned = jacobian.direction[..., None] * across / speed
    longer = jacobian.length[..., None] * along * duration
    return np.asarray(turned + longer)
