"""A block that slides on an ellipsoidal limit surface, and the disc that pushes it.

`SlidingBlock` is what is known beforehand: outline, walls, and the disc with the law that drives
it. `BlockEstimate` is what has to be learned: where the center of friction is, and the limit
surface's arm. Both together make the records that the compiled kernels take.

Lengths are in any unit, the same everywhere; the benchmark PushT has pixels. Theory:
`docs/theory/feedback.md`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from shapely import Polygon, unary_union

from gridpush_drake.dynamics.kernels.contact.walk_round import OutlinePath
from gridpush_drake.dynamics.kernels.steering.driven_disc import Block
from gridpush_drake.errors import PlanningError
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.planning.feedback.ways import make_outline_path


@dataclass(frozen=True)
class DrivenDisc:
    """A disc that a PD law draws to its target, and that nothing holds back.

    Its acceleration is `stiffness` times the way to the target, less `damping` times its velocity,
    applied in steps of `time_step`.

    Attributes:
        radius: radius of the disc.
        stiffness: 1/s².
        damping: 1/s.
        time_step: s.
        substeps: time steps between two decisions.
        low: least target along either axis.
        high: greatest target along either axis.
    """

    radius: float
    stiffness: float
    damping: float
    time_step: float
    substeps: int
    low: float
    high: float

    def __post_init__(self) -> None:
        for name in ("radius", "stiffness", "damping", "time_step", "substeps"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise PlanningError(f"{name} is {value!r}; expected a finite number > 0")
        if not self.low < self.high:
            raise PlanningError(f"low is {self.low!r}; expected less than high, {self.high!r}")


@dataclass(frozen=True)
class BlockEstimate:
    """What is learned of a block.

    Attributes:
        center_x: center of friction along the body's x axis.
        center_y: center of friction along the body's y axis.
        arm: ratio of the limit surface's moment to its force, a length.
    """

    center_x: float
    center_y: float
    arm: float

    def __post_init__(self) -> None:
        if not np.isfinite([self.center_x, self.center_y]).all():
            raise PlanningError("center_x and center_y must be finite")
        if not (np.isfinite(self.arm) and self.arm > 0):
            raise PlanningError(f"arm is {self.arm!r}; expected a finite number > 0")


@dataclass(frozen=True, eq=False)
class SlidingBlock:
    """What is known of a block and of its world before it was pushed.

    Attributes:
        parts: convex parts, each (K, 2) corners in the body frame, all with as many corners. They
            may share edges, but must not overlap.
        disc: the disc that pushes it.
        walls: (4,) low x, low y, high x and high y, between which the block's corners are held.
        slop: overlap of disc and block that is not corrected.
        correction: fraction of the overlap beyond that which is corrected in a time step.

    Raises:
        PlanningError: there is no part, or one is not convex, or the parts are not joined.
    """

    parts: Sequence[ArrayLike]
    disc: DrivenDisc
    walls: tuple[float, float, float, float] = (-np.inf, -np.inf, np.inf, np.inf)
    slop: float = 0.0
    correction: float = 0.1

    def __post_init__(self) -> None:
        expected = "expected convex polygons with as many corners each, (K, 2)"
        corners = [np.array(part, dtype=np.float64) for part in self.parts]
        if not corners or any(part.ndim != 2 or part.shape[1] != 2 for part in corners):
            raise PlanningError(f"parts: {expected}")
        if not all(np.isfinite(part).all() for part in corners):
            raise PlanningError(f"parts: a corner is not finite; {expected}")
        if len({len(part) for part in corners}) > 1:
            raise PlanningError(f"parts: {expected}")
        shapes = [Polygon(part) for part in corners]
        for shape in shapes:
            if not shape.area >= (1 - 1e-9) * shape.convex_hull.area > 0:
                raise PlanningError(f"parts: one is not convex; {expected}")
        if not isinstance(unary_union(shapes), Polygon):
            raise PlanningError("parts: they are apart; expected parts that fraction edges")
        turned = [
            part if shape.exterior.is_ccw else part[::-1]
            for part, shape in zip(corners, shapes, strict=True)
        ]
        object.__setattr__(self, "parts", tuple(turned))

    @cached_property
    def outline(self) -> Polygon:
        """The union of the parts, body frame."""
        return unary_union([Polygon(part) for part in self.parts]).simplify(0.0)

    @cached_property
    def centroid(self) -> Array:
        """(2,) centroid of the area, body frame."""
        return np.array(self.outline.centroid.coords[0])

    @cached_property
    def gyration_radius(self) -> float:
        """Radius of gyration of the area about its centroid."""
        second_moment = 0.0
        for part in self.parts:
            corners = np.asarray(part) - self.centroid
            following = np.roll(corners, -1, axis=0)
            # of a triangle with the origin: area / 6 (a·a + a·b + b·b)
            doubled = corners[:, 0] * following[:, 1] - corners[:, 1] * following[:, 0]
            squares = (corners**2 + corners * following + following**2).sum(axis=1)
            second_moment += float((doubled / 2 * squares / 6).sum())
        return float(np.sqrt(second_moment / self.outline.area))

    @cached_property
    def even_estimate(self) -> BlockEstimate:
        """The estimate of a block whose friction is spread evenly over its area."""
        return BlockEstimate(
            center_x=float(self.centroid[0]),
            center_y=float(self.centroid[1]),
            arm=self.gyration_radius,
        )

    @cached_property
    def ways(self) -> OutlinePath:
        """Where the disc can touch, and how it gets round the block, as the kernels take it."""
        return make_outline_path(self.outline, self.disc.radius)

    def make_record(self, estimate: BlockEstimate) -> Block:
        """Makes the record that the kernels take."""
        parts = np.array(self.parts)
        middles = parts.mean(axis=1)
        reach = np.linalg.norm(parts - middles[:, None], axis=-1).max(axis=1)
        low_x, low_y, high_x, high_y = (float(wall) for wall in self.walls)
        return Block(
            parts=parts,
            circles=np.column_stack([middles, reach]),
            center_x=float(estimate.center_x),
            center_y=float(estimate.center_y),
            rho2=float(estimate.arm) ** 2,
            low_x=low_x,
            low_y=low_y,
            high_x=high_x,
            high_y=high_y,
            radius=float(self.disc.radius),
            kp=float(self.disc.stiffness),
            kd=float(self.disc.damping),
            dt=float(self.disc.time_step),
            substeps=int(self.disc.substeps),
            slop=float(self.slop),
            correction=float(self.correction),
        )
