"""`gridpush/Explore-v0`: identification as a game. An object is pushed so that its motion can be foretold.

After every push a learner that is the same for all players takes in where the object was seen to end. With
z = (log k, log mu_c) ~ N(mean, S) of `identification.posterior`, r the residual of the push, J its exact derivative by
z and R its noise, it makes one step of the extended Kalman filter, taken twice, the second time at the new mean:

    K = S J^T (J S J^T + R)^-1,   mean' = mean - K (r + J (mean - at)),   S' = (I - K J) S (I - K J)^T + K R K^T

Its score is the held-out error: how far, on average, the learner puts the cells from where they truly end under pushes
that nobody makes, m. Reward: the score's decrease in centimeters, and -1 for pushing the object off the table.
"""

from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from gymnasium.spaces import Box
from threadpoolctl import threadpool_limits

from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.gym.episode import Episode, GameOptions, PushGame, Turn
from gridpush_drake.gym.known_shape import KnownShape
from gridpush_drake.identification.noise import NoiseModel, NoiseScale
from gridpush_drake.identification.posterior import Posterior
from gridpush_drake.identification.problem import PushProblem
from gridpush_drake.planning.pregrasp.exploration import calc_worst_std, make_center_functional
from gridpush_drake.planning.pregrasp.uncertainty import UncertainModel
from gridpush_drake.pushes.push_log import ObservedPush, PushLog

TABLE = (4.0, 4.0)
"""Its sides, m: so large that its edge is out of reach."""

HELD_OUT = 6
"""Pushes that the learner is tested on."""

HELD_OUT_DISTANCE = 0.3
"""Of those pushes, as an action: nine centimeters or so."""

ITERATIONS = 2
"""Of the filter's step."""

PER_METER = 100.0
"""Reward for a meter of held-out error."""


@dataclass(frozen=True, eq=False)
class ExploreEpisode(Episode):
    """An episode with a learner.

    Attributes:
        model: what the learner holds possible.
        held_out: the pushes that it is tested on, from the pose (0, 0, 0).
    """

    model: UncertainModel | None = None
    held_out: PushLog = field(default_factory=lambda: PushLog(()))


class Explore(PushGame[ExploreEpisode]):
    """The game."""

    def __init__(self, options: GameOptions | None = None) -> None:
        """Takes what an episode is drawn from."""
        super().__init__(options or GameOptions(), TABLE)

    def begin(self, rng: np.random.Generator) -> ExploreEpisode:
        """Draws an object, and the pushes that the learner is tested on."""
        shape, hidden = self.draw_object(rng)
        start, places = np.append(np.zeros(2), rng.uniform(-np.pi, np.pi)), rng.uniform(-1.0, 1.0, (HELD_OUT, 2))
        pushes = [shape.make_push(np.append(place, HELD_OUT_DISTANCE), np.zeros(3)) for place in places]
        ends = [simulate(shape.obj, hidden, push, regime="quasi_static").final_pose for push in pushes]
        held_out = PushLog(
            tuple(
                ObservedPush(f"held_out_{i}", push, np.zeros(3), np.array([push.duration]), end[None])
                for i, (push, end) in enumerate(zip(pushes, ends, strict=True))
            )
        )
        model = _make_prior(shape)
        error = _calc_held_out_error(model, held_out)
        return ExploreEpisode(
            shape, hidden, rng, start, self.add_noise(start, rng), error, model=model, held_out=held_out
        )

    def judge(self, before: ExploreEpisode, after: ExploreEpisode) -> Turn[ExploreEpisode]:
        """By how much better the learner foretells."""
        assert before.model is not None
        model = learn(before.model, after.pushes[-1])
        error = _calc_held_out_error(model, after.held_out)
        reward = PER_METER * (before.score - error) - after.fallen
        return Turn(replace(after, score=error, model=model), reward)

    def make_own_spaces(self) -> dict[str, Box]:
        """What the learner says of the center of friction: x and y, body frame, and the deviation least known, m."""
        return {"estimate": Box(-1.0, 1.0, (3,))}

    def observe_own(self, episode: ExploreEpisode) -> dict[str, Array]:
        """The values of that."""
        model = episode.model
        assert model is not None
        F, posterior = make_center_functional(model), model.require_posterior()
        center = posterior.calc_share() @ model.obj.p_BC
        return {"estimate": np.append(center, calc_worst_std(F @ posterior.covariance @ F.T))}


@threadpool_limits.wrap(limits=1, user_api="blas")  # small matrices: threads only cost, and reorder sums
def learn(model: UncertainModel, seen: ObservedPush) -> UncertainModel:
    """Takes in where a push was seen to end.

    Args:
        model: what is held possible, with a posterior.
        seen: the push.

    Returns:
        The model after it; the same where the push told nothing.
    """
    before = model.require_posterior()
    end = replace(seen, t_observed=seen.t_observed[-1:], poses_observed=seen.poses_observed[-1:])
    problem = PushProblem(model.obj, PushLog((end,)), model.params.friction)
    mean, S = before.mean, before.covariance
    for _ in range(ITERATIONS):
        linear = problem.linearize(mean)
        J, r = linear.by_z[0], linear.residuals[0]
        if not J.any():
            return model
        R = NoiseModel().calc_covariance(linear.by_inputs[0], NoiseScale())
        gain = np.linalg.solve(J @ S @ J.T + R, J @ S).T
        mean = before.mean - gain @ (r + J @ (before.mean - mean))
    left = np.eye(len(mean)) - gain @ J
    after = Posterior(mean, left @ S @ left.T + gain @ R @ gain.T, before.prior_covariance)
    return replace(model, params=problem.params(mean), posterior=after)


def _calc_held_out_error(model: UncertainModel, held_out: PushLog) -> float:
    problem = PushProblem(model.obj, held_out, model.params.friction)
    return float(problem.calc_cell_errors(problem.residuals(model.require_posterior().mean)).mean())


@lru_cache(maxsize=32)
def _make_prior(shape: KnownShape) -> UncertainModel:
    """What is held possible before any push."""
    return UncertainModel.of_prior(shape.obj)
