"""Random pokes: each begins somewhere on the outline, and keeps the object where it should be.

Candidates are drawn until one of them will do. The k-th candidate of a poke is drawn from (seed,
number of the poke, k) alone, so that it does not depend on the pokes before it, nor on how many
candidates these took.
"""

from dataclasses import dataclass, field
from math import isfinite, pi, radians

import numpy as np
from numpy.typing import ArrayLike
from shapely import LineString, Point, Polygon

from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.pusher import DEFAULT_PUSHER_RADIUS, PusherShape
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import PushError
from gridpush_drake.geometry.se2 import Array, transform_shape
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.exploration.strategy import PokeProposal
from gridpush_drake.planning.push_constraints import PushConstraints

ROUNDING = 1e-6
"""Fraction of the gap between tip and outline that may be missing at the start. A point that is
calculated on the outline is not exactly on it."""

WAYPOINTS = 4
"""Number of poses, evenly spread over a poke, at which the object must be in its region. There may
be something in the way, such as a post, though the object lies clear of it at the end."""


@dataclass(frozen=True)
class RandomPokeOptions:
    """How pokes are drawn.

    Attributes:
        distance: least and greatest length of a push, counted from where the tip would touch the
            outline, m.
        speed: speed of the tip, m/s.
        slant: greatest angle between a push and the outline's normal, rad.
        tip_radius: radius of the finger's tip, m.
        shape: of a pusher that is no disc, in place of the radius; None of a disc.
        clearance: gap between tip and outline at the beginning, m. The way through it comes on top
            of the distance.
        min_motion: a push is drawn again if it is predicted to move the object's cells by less than
            this in the mean, m.
        candidates: greatest number of draws. Then a push that takes the object out of its region is
            taken, if there is no better one.

    Raises:
        PushError: a value is out of range.
    """

    distance: tuple[float, float] = (0.06, 0.10)
    speed: float = 0.03
    slant: float = radians(30)
    tip_radius: float = DEFAULT_PUSHER_RADIUS
    clearance: float = 0.008
    min_motion: float = 0.01
    candidates: int = 100
    shape: PusherShape | None = None

    def __post_init__(self) -> None:
        if not 0 < self.distance[0] <= self.distance[1] < np.inf:
            raise PushError(f"distance is {self.distance!r}; expected 0 < least <= greatest (m)")
        for name in ("speed", "tip_radius"):
            if not (isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise PushError(f"{name} is {getattr(self, name)!r}; expected a positive number")
        if not 0 <= self.slant < pi / 2:
            raise PushError(
                f"slant is {self.slant!r}; expected an angle from 0 to less than pi / 2 (rad)"
            )
        for name in ("clearance", "min_motion"):
            if not (isfinite(getattr(self, name)) and getattr(self, name) >= 0):
                raise PushError(f"{name} is {getattr(self, name)!r}; expected a number >= 0 (m)")
        if self.candidates < 1:
            raise PushError(f"candidates is {self.candidates!r}; expected 1 or more")

    @property
    def reach(self) -> float:
        """How far the pusher reaches from its center at most, m."""
        return self.tip_radius if self.shape is None else self.shape.reach


@dataclass(frozen=True)
class PokeRegion:
    """Where the object should stay while it is poked, polygons in W, m.

    Attributes:
        keep_in: where the whole object should stay.
        middle: where the object's centroid should stay, so that the finger gets at the object from
            all sides; None if nowhere.
    """

    keep_in: Polygon
    middle: Polygon | None = None

    @property
    def center(self) -> Array:
        """Best place for the object's centroid, (2,) in W, m."""
        return np.array((self.middle or self.keep_in).centroid.coords[0])

    def suits(self, centroid: Array) -> bool:
        """Returns whether an object with its centroid at (2,), m, is where it should stay."""
        return self.middle is None or bool(self.middle.covers(Point(centroid)))


@dataclass(frozen=True, eq=False)
class RandomPokes:
    """Proposes random pokes.

    Candidates are drawn one after another. A candidate fits if the tip is beside the object at the
    beginning, if it keeps to the rules, and if it moves the object. The first fitting candidate is
    taken that is predicted to leave the object within its region. If there is none, the fitting
    candidate is taken that ends nearest to the region's center; candidates that keep the object in
    `region.keep_in` go before others.

    Attributes:
        options: how pokes are drawn.
        region: where the object should stay; None for anywhere.
        seed: of the draws.
        number: of the poke, from 1.
        first: number of candidates to pass over, since they were looked at before.
    """

    options: RandomPokeOptions = field(default_factory=RandomPokeOptions)
    region: PokeRegion | None = None
    seed: int = 0
    number: int = 1
    first: int = 0

    def propose(self, belief: Model, pose: ArrayLike, rules: PushConstraints) -> PokeProposal:
        """Proposes the next poke, see `PokeStrategy`; what it tells is not asked for."""
        obj = belief.obj
        q = np.array(pose, dtype=np.float64)
        checker = rules.start_at(obj, q, self.options.reach)
        # The best of the fitting candidates that leave the region, and how bad it is: whether the
        # object leaves `keep_in`, and how far from the center it ends.
        nearest = None
        least = (True, np.inf)
        for attempt in range(self.first, self.first + self.options.candidates):
            poke = self.draw(obj, q, attempt)
            if not self.fits(obj, q, poke, rules) or not rules.allows_push(poke):
                continue
            poses = self.predict(belief, q, poke)
            cells = obj.cells_at(poses[-1])
            if np.linalg.norm(cells - obj.cells_at(q), axis=1).mean() < self.options.min_motion:
                continue
            if not checker.allows_poses(poses).all():
                continue
            if self.region is None:
                return PokeProposal(poke, candidates=attempt + 1)
            keep_in = self.region.keep_in
            leaves = not all(keep_in.covers(transform_shape(each, obj.outline)) for each in poses)
            centroid = cells.mean(axis=0)
            if not leaves and self.region.suits(centroid):
                return PokeProposal(poke, candidates=attempt + 1)
            badness = (leaves, float(np.linalg.norm(centroid - self.region.center)))
            if badness < least:
                nearest = poke
                least = badness
        count = self.first + self.options.candidates
        if nearest is None:
            return PokeProposal(None, "no poke that was drawn fits", candidates=count)
        return PokeProposal(nearest, candidates=count)

    def draw(self, obj: GridObject, pose: Array, attempt: int) -> Push:
        """Draws a candidate: a place on the exterior outline, a slant and a distance, all uniform.

        Args:
            obj: the object.
            pose: (3,) X_WB of the object, m and rad.
            attempt: number of the candidate, from 0.
        """
        options = self.options
        rng = np.random.default_rng((self.seed, self.number, attempt))
        place = rng.uniform(0, obj.edges.perimeter)
        slant = rng.uniform(-1, 1) * options.slant
        distance = rng.uniform(*options.distance)
        return Push.on_outline(
            obj,
            place,
            slant,
            distance + options.clearance,
            radius=options.tip_radius if options.shape is None else options.shape.radius,
            shape=options.shape,
            speed=options.speed,
            pose=pose,
            clearance=options.clearance,
        )

    def fits(self, obj: GridObject, pose: Array, poke: Push, rules: PushConstraints) -> bool:
        """Returns whether the tip has room where it starts, and stays where it may be.

        It has no room in a notch that is too narrow. It goes straight, and may not cross a place
        that was cut out of the finger's region, such as that of a post.
        """
        options = self.options
        outline = transform_shape(pose, obj.outline)
        if options.shape is None:
            gap = outline.distance(Point(poke.start))
            least = options.tip_radius + options.clearance
        else:
            gap = outline.distance(poke.find_area(0.0))
            least = options.clearance
        if gap < (1 - ROUNDING) * least:
            return False
        region = rules.finger_region
        return region is None or bool(region.covers(LineString(poke.xy)))

    def predict(self, model: Model, pose: Array, poke: Push) -> Array:
        """Predicts poses X_WB (WAYPOINTS, 3) of the object on its way, m and rad.

        The last one is that at the end. Inertia is neglected.
        """
        motion = simulate(model, poke, pose, regime="quasi_static", record=[])
        rows = np.linspace(0, len(motion.poses) - 1, WAYPOINTS + 1).round().astype(int)[1:]
        return motion.poses[rows]
