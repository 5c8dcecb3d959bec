"""Objects that touch are pushed until each has room around it: `SeparatePlanner`.

What is left to do in a state of the scene is the room that is lacking,

    V = sum over objects b of (c [d_b < d] + a max(0, d - d_b))       seconds

with the distance d_b of object b from the nearest other one and the room d that each should have.
The next push is the one after which least is left (`search`). A push may move several objects: that
is weighed by where all of them end, and not forbidden. The theory is in `docs/theory/planning.md`,
section 6.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import shapely
from numpy.typing import NDArray

from gridpush_drake.dynamics.bodies import describe_object
from gridpush_drake.dynamics.pusher import Pusher
from gridpush_drake.errors import PlanningError, require_positive
from gridpush_drake.geometry.se2 import Array, transform, transform_shape
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.belief import Belief
from gridpush_drake.planning.scene.loop import (
    SceneAction,
    SceneDecision,
    SceneStep,
    describe_no_room,
)
from gridpush_drake.planning.scene.rules import UNCONSTRAINED, SceneRules
from gridpush_drake.planning.scene.scene_push import ScenePush
from gridpush_drake.planning.scene.search import SceneSearch, SceneSearchOptions
from gridpush_drake.units import MM_PER_M

WANTED_CLEARANCE = 0.03
"""Room that every object should have around it, m."""

EXTRA_CLEARANCE = 0.003
"""By how much more room a push is planned to make, m: it never ends quite where it should."""

PER_LENGTH = 100.0
"""What a meter of room that an object lacks costs, s/m."""

LACKING_COST = 2.0
"""What an object that lacks room costs in any case, s."""

ROWS_APART = 5
"""Steps of a simulated push between two states of which the room is measured."""


ONE_AHEAD = SceneSearchOptions(
    candidates=24,
    firsts=2,
    seconds=6,
    compared=3,
    lengths=(0.01, 0.15),
    slant=0.6,
    pusher=Pusher(speed=0.05),
)
"""How pushes that separate are searched for: one ahead, for the state of a second is much alike."""


@dataclass(frozen=True)
class SeparationOptions:
    """How objects are separated.

    Attributes:
        margin: room that every object should have around it, m.
        search: how pushes are searched for.

    Raises:
        PlanningError: the margin is not positive.
    """

    margin: float = WANTED_CLEARANCE
    search: SceneSearchOptions = ONE_AHEAD

    def __post_init__(self) -> None:
        require_positive(PlanningError, margin=self.margin)


class SeparatePlanner:
    """Pushes objects apart.

    Attributes:
        objects: the N objects.
        options: how they are separated.
        rules: what no push may do.
    """

    def __init__(
        self,
        objects: Sequence[GridObject],
        options: SeparationOptions | None = None,
        rules: SceneRules = UNCONSTRAINED,
        *,
        seed: int = 0,
    ) -> None:
        """Makes the planner.

        Args:
            objects: the objects.
            options: how they are separated.
            rules: what no push may do.
            seed: seed of the pushes that are drawn.
        """
        self.objects = tuple(objects)
        self.options = options or SeparationOptions()
        self.rules = rules
        self._seed = seed

    def decide(self, poses: Array, belief: Belief, steps: Sequence[SceneStep]) -> SceneDecision:
        """Decides what to do next; see `ScenePlanner`."""
        clearances = calc_clearances(self.objects, poses)
        lacking = [int(b) for b in np.flatnonzero(clearances < self.options.margin)]
        room = f"{self.options.margin * MM_PER_M:g} mm"
        if not lacking:
            return SceneDecision(SceneAction.DONE, f"every object has {room} around it")
        found = self._find_push(poses, belief, lacking, (self._seed, len(steps)))
        if found is None:
            reason = describe_no_room(self.objects, lacking, self.options.search.pusher)
            return SceneDecision(SceneAction.FAIL, reason)
        name = describe_object(self.objects, found.body)
        return SceneDecision(
            SceneAction.PUSH,
            f"{name} away from others, {len(lacking)} of {len(poses)} lack {room} around them",
            push=found.push,
            body=found.body,
            expected=found.poses,
        )

    def _find_push(
        self, poses: Array, belief: Belief, lacking: Sequence[int], seed: tuple[int, ...]
    ) -> ScenePush | None:
        """Searches for a push at an object that lacks room; where none fits, at any."""
        rng = np.random.default_rng(seed)
        search = SceneSearch(belief, self.rules, self.options.search)
        found = search.find_push(poses, self.calc_cost, lacking, rng)
        if found is None:
            found = search.find_push(poses, self.calc_cost, range(len(poses)), rng)
        return found

    def calc_cost(self, poses: Array) -> Array:
        """Calculates V, what is left to do, (K,) s, of states (K, N, 3) along a push."""
        # of a few states along a push; in between it changes evenly
        rows = np.unique(np.append(np.arange(0, len(poses), ROWS_APART), len(poses) - 1))
        apart = calc_clearances_along(self.objects, poses[rows])
        wanted = self.options.margin + EXTRA_CLEARANCE
        left = PER_LENGTH * np.maximum(wanted - apart, 0.0) + LACKING_COST * (apart < wanted)
        return np.interp(np.arange(len(poses)), rows, left.sum(axis=1))


def calc_clearances(objects: Sequence[GridObject], poses: Array) -> Array:
    """Calculates the distance of each object from the nearest other one, (N,) m.

    Args:
        objects: the objects.
        poses: (N, 3) where they lie, m and rad.
    """
    outlines = np.array(
        [transform_shape(pose, obj.outline) for obj, pose in zip(objects, poses, strict=True)]
    )
    apart = shapely.distance(outlines[:, None], outlines[None, :])
    np.fill_diagonal(apart, np.inf)
    return np.asarray(apart.min(axis=1))


def calc_clearances_along(objects: Sequence[GridObject], poses: Array) -> Array:
    """Calculates the distance of each object from the nearest other one, (K, N) m; no holes count.

    Args:
        objects: the objects.
        poses: (K, N, 3) where they lie in each of K states, m and rad.
    """
    placed: list[NDArray[np.object_]] = []
    for b, obj in enumerate(objects):
        corners = np.array(obj.outline.exterior.coords)[:-1]
        placed.append(np.asarray(shapely.polygons(transform(poses[:, b], corners))))
    nearest = np.full(poses.shape[:2], np.inf)
    for i, j in combinations(range(len(objects)), 2):
        apart = shapely.distance(placed[i], placed[j])
        nearest[:, i] = np.minimum(nearest[:, i], apart)
        nearest[:, j] = np.minimum(nearest[:, j], apart)
    return nearest
