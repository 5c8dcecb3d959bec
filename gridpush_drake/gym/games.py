"""The games: what is drawn for an episode, what a push is worth, and when the aim is reached.

In all of them the reward is how much better the score gets, and -1 for pushing the object off the
table.
"""

from dataclasses import replace
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np
from gymnasium.spaces import Box
from threadpoolctl import threadpool_limits

from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import PlanningError
from gridpush_drake.geometry.se2 import Array, rotate, wrap_angle
from gridpush_drake.gym.episode import (
    SPACE_MARGIN,
    EpisodeState,
    GameOptions,
    PushGame,
    Turn,
    flatten_pose,
)
from gridpush_drake.gym.known_shape import KnownShape
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.statistics.noise import NoiseModel, NoiseScale
from gridpush_drake.identification.statistics.posterior import Posterior
from gridpush_drake.identification.statistics.problem import PushProblem
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.belief import Belief
from gridpush_drake.planning.contact.trial import calc_goal_error
from gridpush_drake.planning.exploration.designed_pokes import (
    calc_worst_std,
    make_center_functional,
)
from gridpush_drake.planning.pregrasp.goals import calc_overhangs
from gridpush_drake.pushes.push_log import ObservedPush, PushLog

PER_METER = 10.0
"""Reward for a meter towards the goal, or over the edge."""

PER_METER_PREDICTED = 100.0
"""Reward for a meter less of held-out error."""

GOAL_EDGE_MARGIN = 0.1
"""Least distance inside the table's edge of an object with a goal, at the beginning and at the
goal, m."""

MIN_ERROR = 0.1
"""Least mean cell error to the goal at the beginning, m."""

GOAL_TOLERANCE = 0.02
"""Mean cell error below which the goal is reached, m; the paper's."""

T_REACHED = 0.005
"""Mean cell error at which the T is at its goal, m."""

T_UNIT = 0.001
"""Length of a pixel of the benchmark PushT in `PushTHidden`, m."""

T_OUTLINE = (
    (-60, 0),
    (60, 0),
    (60, 30),
    (15, 30),
    (15, 120),
    (-15, 120),
    (-15, 30),
    (-60, 30),
)
"""Corners of the T, in pixels of the benchmark."""

T_PARTS = {
    1: ((-60, 0), (0, 0), (0, 30), (-60, 30)),
    2: ((0, 0), (60, 0), (60, 30), (0, 30)),
    3: ((-15, 30), (15, 30), (15, 80), (-15, 80)),
    4: ((-15, 80), (15, 80), (15, 120), (-15, 120)),
}
"""Parts of the T, each with a mass and a friction of its own: the bar's halves, and the stem's near
and far end."""

T_CELLS = 63
"""Greatest number of the T's cells, which are about a centimeter wide."""

INITIAL_POKES = 3
"""Number of random pokes that were made and seen before the first stroke."""

POKE_DISTANCE = -0.4
"""Distance of such a poke, as an action: about 5 cm."""

T_DISTANCE = (0.08, 0.2)
"""Least and greatest distance of the T's goal from where it lies, m."""

T_TURN = np.pi / 2
"""Greatest angle of the T's goal from where it lies, rad."""

MAX_START_OFFSET = 0.05
"""Greatest distance from the table's middle, along each axis, of an object that is to be slid, at
the beginning, m."""

MAX_ARM = 0.06
"""Greatest distance of a part that is to be grasped from the center of mass, m."""

HELD_OUT = 6
"""Number of pushes that the learner is tested on."""

HELD_OUT_DISTANCE = 0.3
"""Length of these pushes as an action: nine centimeters or so."""

FILTER_ITERATIONS = 2
"""Number of iterations of the filter's step."""


class PushToGoal(PushGame):
    """`gridpush/PushToGoal-v0`: an object of hidden masses is pushed to a goal pose.

    The table is large.

    Its score is the mean distance of the cells from where they are at the goal, m (the paper's
    ADD). Reward: the score's decrease in decimeters, and 1 for coming within 2 cm, which ends the
    episode.
    """

    table = (1.4, 1.2)
    reached: ClassVar[float] = GOAL_TOLERANCE

    def begin(self, rng: np.random.Generator) -> EpisodeState:
        """Draws an object, where it lies and where it should."""
        shape, hidden = self.draw_object(rng)
        start = self._draw_pose(shape, rng)
        goal = start
        error = 0.0
        while error < MIN_ERROR:
            goal = self._draw_pose(shape, rng)
            error = float(calc_goal_error(shape.obj, start, goal))
        return EpisodeState(
            shape=shape,
            hidden=hidden,
            rng=rng,
            true_pose=start,
            pose=self.add_noise(start, rng),
            score=error,
            goal=goal,
        )

    def measure(self, episode: EpisodeState) -> float:
        """Calculates the mean distance of the cells from where they are at the goal, m."""
        assert episode.goal is not None
        return float(calc_goal_error(episode.shape.obj, episode.true_pose, episode.goal))

    def judge(self, before: EpisodeState, after: EpisodeState) -> Turn[EpisodeState]:
        """Rewards by how much nearer the goal is."""
        error = self.measure(after)
        won = error < self.reached and not after.fallen
        reward = PER_METER * (before.score - error) + won - after.fallen
        return Turn(replace(after, score=error), reward, won)

    def make_own_spaces(self) -> dict[str, Box]:
        """Makes the space of the goal, in the form of the pose."""
        limit = np.array([*self._half, 1.0, 1.0], dtype=np.float32)
        return {"goal": Box(-limit, limit)}

    def observe_own(self, episode: EpisodeState) -> dict[str, Array]:
        """Returns the goal, in the form of the pose."""
        assert episode.goal is not None
        return {"goal": flatten_pose(episode.goal)}

    def _draw_pose(self, shape: KnownShape, rng: np.random.Generator) -> Array:
        """Draws a pose (3,) in which the object is wholly on the table."""
        while True:
            pose = np.append(rng.uniform(-self._half, self._half), rng.uniform(-np.pi, np.pi))
            if self.surface.contains_cells(shape.obj, pose, GOAL_EDGE_MARGIN):
                return pose


def make_t() -> GridObject:
    """Makes the T of the benchmark PushT, a pixel being `T_UNIT`."""
    parts: dict[int, Any] = {}
    for label, corners in T_PARTS.items():
        parts[label] = np.array(corners) * T_UNIT
    return GridObject.from_outline(
        np.array(T_OUTLINE) * T_UNIT,
        parts=parts,
        max_cells=T_CELLS,
        name="t",
    )


class PushTHidden(PushToGoal):
    """`gridpush/PushTHidden-v0`: the T of PushT, with a hidden load, in four strokes to its goal.

    The T's four parts have masses and frictions that nobody is told. `INITIAL_POKES` random pokes
    were made and seen before. Then there are four strokes, each carried out as it was chosen,
    without looking. So few leave no time to correct what a wrong model did. The score is the mean
    distance of the cells from where they are at the goal, m. Reward: its decrease in decimeters,
    and 1 for coming within 5 mm, which ends the episode.
    """

    defaults: ClassVar[dict[str, Any]] = {"max_pushes": 4}
    reached = T_REACHED

    @classmethod
    def list_defaults(cls) -> dict[str, Any]:
        """Options that the game has other defaults for, the T among them."""
        return {**cls.defaults, "objects": (make_t(),)}

    def begin(self, rng: np.random.Generator) -> EpisodeState:
        """Draws the hidden load, pokes the T, and draws its goal."""
        shape, hidden = self.draw_object(rng)
        start = np.append(np.zeros(2), rng.uniform(-np.pi, np.pi))
        episode = EpisodeState(shape, hidden, rng, start, self.add_noise(start, rng))
        # The pokes are made like strokes, but are worth nothing: there is no goal yet.
        for _ in range(INITIAL_POKES):
            action = np.append(rng.uniform(-1.0, 1.0, 2), POKE_DISTANCE)
            (episode,) = self.push([episode], [action])
        placed = replace(episode, goal=self._draw_goal(episode, rng))
        return replace(placed, score=self.measure(placed))

    def is_cut_off(self, episode: EpisodeState) -> bool:
        """Whether all strokes were made; the pokes are none."""
        return len(episode.pushes) >= INITIAL_POKES + self.options.max_pushes

    def make_own_spaces(self) -> dict[str, Box]:
        """The goal, as the pose, and the pokes: action and motion of each."""
        # as the spaces of "last_action" and "last_motion", which a poke is told by
        step = np.append(2 * (self._half + SPACE_MARGIN), np.pi)
        limit = np.concatenate([np.ones(3), step])
        limit = np.tile(limit, INITIAL_POKES).astype(np.float32)
        return {**super().make_own_spaces(), "pokes": Box(-limit, limit)}

    def observe_own(self, episode: EpisodeState) -> dict[str, Array]:
        """The goal, as the pose, and the pokes: action and motion of each."""
        rows = []
        for seen in episode.pushes[:INITIAL_POKES]:
            before = seen.pose
            action = episode.shape.find_action(seen.push, before)
            # the motion in the T's own frame before the poke
            change = seen.final_pose - before
            move = rotate(-before[2], change[:2])
            turn = wrap_angle(change[2])
            rows.append(np.concatenate([action, move, [turn]]))
        return {**super().observe_own(episode), "pokes": np.concatenate(rows)}

    def _draw_goal(self, episode: EpisodeState, rng: np.random.Generator) -> Array:
        """A pose (3,) not far from where the T lies."""
        pose = episode.true_pose
        while True:
            angle = rng.uniform(-np.pi, np.pi)
            distance = rng.uniform(*T_DISTANCE)
            turn = rng.uniform(-T_TURN, T_TURN)
            x = pose[0] + distance * np.cos(angle)
            y = pose[1] + distance * np.sin(angle)
            goal = np.array([x, y, pose[2] + turn])
            if self.surface.contains_cells(episode.shape.obj, goal, GOAL_EDGE_MARGIN):
                return goal


class SlideToEdge(PushGame):
    """`gridpush/SlideToEdge-v0`: an object is pushed over the table's edge, to be grasped.

    Graspable are its narrow parts near the true center of mass, where it does not turn in the
    gripper. Its score is how far the part that is farthest out hangs over the edge, m; negative
    while some of what the gripper needs is over the table. Reward: the score's increase in
    decimeters, and 1 when a part is out, which ends the episode.
    """

    table = (0.9, 0.7)
    defaults: ClassVar[dict[str, Any]] = {"max_pushes": 30}

    def __init__(self, options: GameOptions | None = None) -> None:
        """Takes what an episode is drawn from.

        Raises:
            PlanningError: an object has no graspable part.
        """
        super().__init__(options)
        for shape in self.shapes:
            if not shape.grasp_parts:
                raise PlanningError(
                    f"objects: {shape.obj.name} has no part narrow enough to be grasped"
                )

    def begin(self, rng: np.random.Generator) -> EpisodeState:
        """Draws an object, and where it lies near the table's middle.

        It is drawn again where it cannot be grasped near enough to its center of mass.
        """
        while True:
            shape, hidden = self.draw_object(rng)
            center = hidden.center_of_mass(shape.obj)
            near = tuple(
                part for part in shape.grasp_parts if np.linalg.norm(part.p_BG - center) <= MAX_ARM
            )
            if near:
                break
        start = np.append(
            rng.uniform(-MAX_START_OFFSET, MAX_START_OFFSET, 2), rng.uniform(-np.pi, np.pi)
        )
        score = float(calc_overhangs(near, start, self.surface).max())
        return EpisodeState(
            shape=shape,
            hidden=hidden,
            rng=rng,
            true_pose=start,
            pose=self.add_noise(start, rng),
            score=score,
            parts=near,
        )

    def measure(self, episode: EpisodeState) -> float:
        """Calculates how far the part that is farthest out hangs over the edge, m."""
        return float(calc_overhangs(episode.parts, episode.true_pose, self.surface).max())

    def judge(self, before: EpisodeState, after: EpisodeState) -> Turn[EpisodeState]:
        """Rewards by how much farther out a part is."""
        overhang = self.measure(after)
        won = overhang >= 0 and not after.fallen
        reward = PER_METER * (overhang - before.score) + won - after.fallen
        return Turn(replace(after, score=overhang), reward, won)


class Explore(PushGame):
    """`gridpush/Explore-v0`: an object is pushed so that its motion can be predicted.

    No edge is within reach.

    After every push a learner that is the same for all players takes in where the object was seen
    to end (`learn`). Its score is the held-out error: how far, on average, the learner puts the
    cells from where they truly end under pushes that nobody makes, m. Reward: the score's decrease
    in centimeters.
    """

    table = (4.0, 4.0)
    defaults: ClassVar[dict[str, Any]] = {"max_pushes": 8}

    def begin(self, rng: np.random.Generator) -> EpisodeState:
        """Draws an object, and the pushes that the learner is tested on."""
        shape, hidden = self.draw_object(rng)
        start = np.append(np.zeros(2), rng.uniform(-np.pi, np.pi))
        places = rng.uniform(-1.0, 1.0, (HELD_OUT, 2))
        pushes = [
            shape.make_push(np.append(place, HELD_OUT_DISTANCE), np.zeros(3)) for place in places
        ]
        ends = [
            simulate(Model(shape.obj, hidden), push, regime="quasi_static").final_pose
            for push in pushes
        ]
        held_out = PushLog(
            tuple(
                ObservedPush(
                    f"held_out_{i}", push, np.zeros(3), np.array([push.duration]), end[None]
                )
                for i, (push, end) in enumerate(zip(pushes, ends, strict=True))
            )
        )
        model = _make_prior(shape)
        error = _calc_held_out_error(model, held_out)
        return EpisodeState(
            shape=shape,
            hidden=hidden,
            rng=rng,
            true_pose=start,
            pose=self.add_noise(start, rng),
            score=error,
            model=model,
            held_out=held_out,
        )

    def measure(self, episode: EpisodeState) -> float:
        """Calculates how far, on average, the learner puts cells from where they truly end, m."""
        assert episode.model is not None
        return _calc_held_out_error(episode.model, episode.held_out)

    def judge(self, before: EpisodeState, after: EpisodeState) -> Turn[EpisodeState]:
        """Rewards by how much better the learner predicts."""
        assert before.model is not None
        model = learn(before.model, after.pushes[-1])
        error = _calc_held_out_error(model, after.held_out)
        reward = PER_METER_PREDICTED * (before.score - error) - after.fallen
        return Turn(replace(after, score=error, model=model), reward)

    def make_own_spaces(self) -> dict[str, Box]:
        """Makes the space of what the learner says of the center of friction.

        That is x and y, body frame, and the greatest standard deviation, m.
        """
        return {"estimate": Box(-1.0, 1.0, (3,))}

    def observe_own(self, episode: EpisodeState) -> dict[str, Array]:
        """Returns what the learner says of the center of friction."""
        model = episode.model
        assert model is not None
        F = make_center_functional(model)
        posterior = model.require_posterior()
        center = posterior.calc_fraction() @ model.obj.p_BC
        return {"estimate": np.append(center, calc_worst_std(F @ posterior.covariance @ F.T))}


# the matrices are small: threads only cost time, and reorder sums
@threadpool_limits.wrap(limits=1, user_api="blas")
def learn(model: Belief, seen: ObservedPush) -> Belief:
    """Takes in where a push was seen to end; gives the same model where the push told nothing.

    With z = (log k, log mu_c) ~ N(mean, S) of `identification.statistics.posterior`, r the residual
    of the push, J its exact derivative by z and R its noise, it makes one step of the extended
    Kalman filter, taken twice, the second time at the new mean:

        K     = S J^T (J S J^T + R)^-1
        mean' = mean - K (r + J (mean - at))
        S'    = (I - K J) S (I - K J)^T + K R K^T
    """
    before = model.require_posterior()
    end = replace(seen, t_observed=seen.t_observed[-1:], poses_observed=seen.poses_observed[-1:])
    problem = PushProblem(model.obj, PushLog((end,)), model.params, model.physics)
    mean = before.mean
    S = before.covariance
    for _ in range(FILTER_ITERATIONS):
        linear = problem.linearize(mean)
        J = linear.by_z[0]
        r = linear.residuals[0]
        if not J.any():
            return model  # the push did not move the object
        R = NoiseModel().calc_covariance(linear.by_inputs[0], NoiseScale())
        gain = np.linalg.solve(J @ S @ J.T + R, J @ S).T
        mean = before.mean - gain @ (r + J @ (before.mean - mean))
    left = np.eye(len(mean)) - gain @ J
    after = Posterior(mean, left @ S @ left.T + gain @ R @ gain.T, before.prior_covariance)
    bodies = model.bodies.with_params(problem.params(mean))
    return replace(model, bodies=bodies, posterior=after)


def _calc_held_out_error(model: Belief, held_out: PushLog) -> float:
    problem = PushProblem(model.obj, held_out, model.params, model.physics)
    return float(problem.calc_cell_errors(problem.residuals(model.require_posterior().mean)).mean())


@lru_cache(maxsize=32)
def _make_prior(shape: KnownShape) -> Belief:
    """Makes what is held possible before any push."""
    return Belief.of_prior(shape.obj)
