"""Searches for the next push of several objects, for all tasks with several objects.

A task says what a state of the scene costs, V(q_1, ..., q_N): the time that is still needed from
there, s. The search for the next push has four steps:

    1. Many pushes are drawn along the outlines and simulated by the scene model, with all contacts.
       Each is cut at the time t at which t + V(poses after t) is least, so that one simulation also
       tells the best length of the push.
    2. The best of them are varied a little.
    3. For the best after that, second pushes are simulated, to find what they would bring.
    4. The few best are simulated with further models. The push with the least average cost is made.

A push may touch other objects: what counts is where all of them end.

What no push may do is in `rules`: push an object near the table's edge or against a post, or begin
where the finger does not fit. The theory is in `docs/theory/planning.md`, section 6.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.pusher import Pusher
from gridpush_drake.errors import PlanningError, require_positive
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.planning.belief import Belief
from gridpush_drake.planning.scene.rollouts import Rollout, SceneRollouts, roll_models
from gridpush_drake.planning.scene.rules import (
    CONSTRAINT_SLACK,
    UNCONSTRAINED,
    RoomLimits,
    SceneRoom,
    SceneRules,
)
from gridpush_drake.planning.scene.scene_push import PushStop, ScenePush, cut_push

CostToGo = Callable[[Array], Array]
"""Takes poses (K, N, 3), m and rad, and returns what each state of the scene costs, (K,) s."""

DRAWS_A_PLACE = 3
"""Number of pushes that are drawn for each one that is simulated, as the pusher does not fit
everywhere."""

STOPS_A_STEP = 6
"""Number of places between two steps of a simulation at which a push may stop: every 0.5 mm."""

PLACE_SPREAD = 0.03
"""Standard deviation of the place of a push that is varied, as a fraction of the perimeter."""

ANGLE_SPREAD = 0.15
"""Standard deviation of the angle of a push that is varied, rad."""

REFINEMENT_FACTOR = 3
"""The later half of the variations is smaller by the factor 1 + REFINEMENT_FACTOR."""


SEARCH_PUSHER = Pusher(speed=0.05, clearance=0.003)
"""What pushes several objects by default: faster than one that learns, and with more room."""


@dataclass(frozen=True)
class SceneSearchOptions:
    """How the next push is searched for.

    Attributes:
        candidates: number of pushes that are drawn and simulated for each object that is to move.
        refined: number of the best of them that are varied.
        variations: number of variations of each of these.
        firsts: number of pushes after which second pushes are simulated.
        seconds: number of second pushes that are simulated for each object, after each first one.
        compared: number of pushes that are simulated with all further models.
        lengths: least and greatest length of a push, its clearance left out, m.
        slant: greatest angle of a push from the outline's inward normal, rad.
        pusher: what pushes.
        approach_time: approximate time that the finger takes from one push to the next, s.
        workers: number of threads that simulate; no result depends on it.

    Raises:
        PlanningError: a number is not positive, or the lengths do not increase.
    """

    candidates: int = 48
    refined: int = 4
    variations: int = 8
    firsts: int = 5
    seconds: int = 14
    compared: int = 5
    lengths: tuple[float, float] = (0.003, 0.2)
    slant: float = 0.8
    pusher: Pusher = SEARCH_PUSHER
    approach_time: float = 2.0
    workers: int = 1

    def __post_init__(self) -> None:
        require_positive(
            PlanningError,
            candidates=self.candidates,
            slant=self.slant,
            workers=self.workers,
            least_length=self.lengths[0],
        )
        if not self.lengths[0] <= self.lengths[1] < np.inf:
            raise PlanningError(
                f"lengths are {self.lengths!r}; expected the least and the greatest, m"
            )
        for name in ("refined", "variations", "firsts", "seconds", "compared"):
            value = getattr(self, name)
            if not 0 <= value < np.inf:
                raise PlanningError(f"{name} is {value!r}; expected a number >= 0")


class SceneSearch:
    """Searches for pushes of the objects of a scene.

    Attributes:
        belief: what is believed of the objects.
        rules: what no push may do.
        options: how it searches.
        room: says where objects and finger may be by the rules.
    """

    def __init__(
        self,
        belief: Belief,
        rules: SceneRules = UNCONSTRAINED,
        options: SceneSearchOptions | None = None,
    ) -> None:
        """Prepares simulations by all models."""
        self.belief = belief
        self.rules = rules
        self.options = options or SceneSearchOptions()
        workers = self.options.workers
        self._best = SceneRollouts(belief.bodies, workers=workers)
        self._others = [SceneRollouts(scene, workers=workers) for scene in belief.samples]
        self.room = SceneRoom(belief.objects, rules)

    @property
    def simulations(self) -> int:
        """Number of pushes that were simulated so far."""
        return self._best.simulations + sum(each.simulations for each in self._others)

    def find_push(
        self,
        poses: Array,
        cost: CostToGo,
        bodies: Sequence[int],
        rng: np.random.Generator,
        *,
        detours: Sequence[CostToGo] = (),
        longest: float | None = None,
    ) -> ScenePush | None:
        """Searches for the push to make next.

        Args:
            poses: (N, 3) where the objects lie, m and rad.
            cost: what a state costs.
            bodies: numbers of the objects on whose outlines pushes begin.
            rng: draws the pushes.
            detours: other costs, by which first pushes are chosen, too, after which a second push
                may do better: to turn an object first where it lies, say.
            longest: greatest length of a push, m; that of the options where None.

        Returns:
            The push; None where the finger fits nowhere, or no push is allowed.
        """
        options = self.options
        # As long as it may be: each push is cut where it costs least.
        reach = options.lengths[1] if longest is None else min(longest, options.lengths[1])
        reach = max(reach, options.lengths[0])
        drawn = self._draw(poses, bodies, options.candidates, reach, rng)
        rolled = self._best.roll_all([each[3] for each in drawn], poses)
        tried = self._cut(poses, cost, drawn, rolled)
        tried += self._vary(poses, cost, tried, reach, rng)
        tried.sort(key=lambda each: each.cost)

        # What would a second push bring after each of the best, and after detours?
        scored = [(each.cost, each) for each in tried]
        firsts = _pick_different(tried, options.firsts)
        for detour in detours:
            turned = sorted(self._cut(poses, detour, drawn, rolled), key=lambda each: each.cost)
            for each in _pick_different(turned, options.firsts):
                left = float(cost(each.poses[None])[0])
                firsts.append(replace(each, cost=left + each.push.duration, left=left))
        at_once = []
        for first in firsts:
            after = first.cost - first.left + options.approach_time
            drawn = self._draw(first.poses, bodies, options.seconds, options.lengths[1], rng)
            rolled = self._best.roll_all([each[3] for each in drawn], first.poses)
            seconds = self._cut(first.poses, cost, drawn, rolled)
            if seconds:
                second = min(seconds, key=lambda each: each.cost)
                scored.append((min(after + second.cost, first.cost), first))
                at_once.append((second.body, second.arc_length, second.angle))
        # A good second push may be as good at once. Were it not asked, a push that hardly moves
        # anything could be chosen over and over again, for what a second one would bring.
        fitting = self._keep_fitting(poses, at_once, options.lengths[1])
        rolled = self._best.roll_all([each[3] for each in fitting], poses)
        scored += [(each.cost, each) for each in self._cut(poses, cost, fitting, rolled)]
        # By the other models it may look different.
        scored.sort(key=lambda pair: pair[0])
        return self._compare(poses, cost, scored)

    def _draw(
        self,
        poses: Array,
        bodies: Sequence[int],
        count: int,
        reach: float,
        rng: np.random.Generator,
    ) -> list[tuple[int, float, float, Push]]:
        """Draws pushes along the outlines of some objects, at most `count` for each."""
        slant = self.options.slant
        drawn = []
        for body in bodies:
            perimeter = self.belief.objects[body].edges.perimeter
            places = rng.uniform(0.0, perimeter, DRAWS_A_PLACE * count)
            angles = rng.uniform(-slant, slant, DRAWS_A_PLACE * count)
            own = [(body, *pair) for pair in zip(places.tolist(), angles.tolist(), strict=True)]
            drawn += self._keep_fitting(poses, own, reach)[:count]
        return drawn

    def _vary(
        self,
        poses: Array,
        cost: CostToGo,
        tried: Sequence[ScenePush],
        reach: float,
        rng: np.random.Generator,
    ) -> list[ScenePush]:
        """Varies place and angle of the best pushes, less in the second half."""
        best = sorted(tried, key=lambda each: each.cost)[: self.options.refined]
        drawn = []
        for each in best:
            perimeter = self.belief.objects[each.body].edges.perimeter
            for i in range(self.options.variations):
                fraction = PLACE_SPREAD / (
                    1 + (i >= self.options.variations // 2) * REFINEMENT_FACTOR
                )
                place = each.arc_length + fraction * perimeter * rng.standard_normal()
                turned = each.angle + ANGLE_SPREAD * rng.standard_normal()
                angle = float(np.clip(turned, -self.options.slant, self.options.slant))
                drawn.append((each.body, float(place), angle))
        fitting = self._keep_fitting(poses, drawn, reach)
        rolled = self._best.roll_all([each[3] for each in fitting], poses)
        return self._cut(poses, cost, fitting, rolled)

    def _keep_fitting(
        self, poses: Array, drawn: Sequence[tuple[int, float, float]], reach: float
    ) -> list[tuple[int, float, float, Push]]:
        """Makes pushes of (object, place, angle), and keeps those that can begin where they do."""
        options = self.options
        radius = options.pusher.choose_radius(self.belief.objects)
        made = []
        for body, place, angle in drawn:
            push = Push.on_outline(
                self.belief.objects[body],
                place,
                angle,
                reach + options.pusher.clearance,
                radius=radius,
                shape=options.pusher.shape,
                speed=options.pusher.speed,
                pose=poses[body],
                clearance=options.pusher.clearance,
            )
            made.append((body, place, angle, push))
        fits = self.room.fits_pusher(poses, [each[3] for each in made])
        return [each for each, fit in zip(made, fits.tolist(), strict=True) if fit]

    def _cut(
        self,
        poses: Array,
        cost: CostToGo,
        drawn: Sequence[tuple[int, float, float, Push]],
        rolled: Sequence[Rollout],
    ) -> list[ScenePush]:
        """Cuts pushes, as the best model has them, each to its best length; some are left out."""
        limits = self.room.make_limits(poses)
        found = []
        for (body, place, angle, push), rollout in zip(drawn, rolled, strict=True):
            if not (rollout.touched and rollout.solved):
                continue
            stop = self._find_stop(push, rollout, cost, limits)
            if stop is None:
                continue
            found.append(
                ScenePush(
                    body=body,
                    arc_length=place,
                    angle=angle,
                    push=cut_push(push, stop.traveled),
                    poses=stop.poses,
                    cost=stop.left + stop.traveled / self.options.pusher.speed,
                    left=stop.left,
                )
            )
        return found

    def _find_stop(
        self, push: Push, rollout: Rollout, cost: CostToGo, limits: RoomLimits
    ) -> PushStop | None:
        """Finds where to stop in a rollout; None where it may not even begin."""
        last = len(rollout.traveled)
        # up to where a rule is broken
        inside = self.room.keeps_room(rollout.poses, limits)
        ends = self.room.allows_finger(push.tip_at(rollout.traveled / self.options.pusher.speed))
        allowed_rows = inside & ends
        if not allowed_rows.all():
            last = int(np.argmin(allowed_rows))
        least = self.options.pusher.clearance + self.options.lengths[0]
        first = int(np.searchsorted(rollout.traveled, least - CONSTRAINT_SLACK))
        if first >= last:
            return None
        # the best of the steps, and then of places between it and those beside it
        best = first + int(
            np.argmin(self._rate(rollout, np.arange(first, last, dtype=float), cost)[0])
        )
        places = np.arange(-STOPS_A_STEP, STOPS_A_STEP + 1) / STOPS_A_STEP + best
        places = places[(places >= first) & (places <= last - 1)]
        values, left = self._rate(rollout, places, cost)
        at = int(np.argmin(values))
        traveled, poses = rollout.interpolate(places[at : at + 1])
        return PushStop(traveled=float(traveled[0]), poses=poses[0], left=float(left[at]))

    def _rate(self, rollout: Rollout, places: Array, cost: CostToGo) -> tuple[Array, Array]:
        """Calculates the cost of stopping after so many steps (K,), and what is left then, s."""
        traveled, poses = rollout.interpolate(places)
        left = cost(poses)
        return left + traveled / self.options.pusher.speed, left

    def _compare(
        self, poses: Array, cost: CostToGo, scored: Sequence[tuple[float, ScenePush]]
    ) -> ScenePush | None:
        """Picks the push that costs least on the average of all models, and that a robot can make.

        Args:
            poses: (N, 3) where the objects lie, m and rad.
            cost: what a state costs.
            scored: pushes with what they cost by the best model, the best first.
        """
        limits = self.room.make_limits(poses, further=True)
        compared: list[tuple[float, ScenePush]] = []
        seen: set[int] = set()
        for score, each in scored:
            if id(each) in seen or not self.rules.allows_push(each.push):
                continue
            seen.add(id(each))
            if not self._others:
                return each
            mean = self._average(poses, cost, each, limits)
            if mean is None:
                continue
            compared.append((score - each.left + mean, each))
            if len(compared) >= max(self.options.compared, 1):
                break
        if not compared:
            return None
        return min(compared, key=lambda pair: pair[0])[1]

    def _average(
        self, poses: Array, cost: CostToGo, each: ScenePush, limits: RoomLimits
    ) -> float | None:
        """Averages what is left after a push over all models, s; None where one breaks a rule."""
        left = [each.left]
        for rollout in roll_models(self._others, each.push, poses, self.options.workers):
            if not self.room.keeps_room(rollout.poses, limits).all():
                return None
            left.append(float(cost(rollout.poses[-1:])[0]))
        return float(np.mean(left))


def _pick_different(tried: Sequence[ScenePush], count: int) -> list[ScenePush]:
    """Picks some of the best pushes, not all of one object."""
    taken: dict[int, int] = {}
    picked = []
    for each in tried:
        if taken.get(each.body, 0) < max(2, count // 2):
            taken[each.body] = taken.get(each.body, 0) + 1
            picked.append(each)
        if len(picked) == count:
            break
    return picked
