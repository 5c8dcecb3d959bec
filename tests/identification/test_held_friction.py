"""Over the edge loads shift about the center of mass, which weighings tell and pushes do not."""

import numpy as np
import pytest

from gridpush_drake.dynamics.push import Push
from gridpush_drake.errors import IdentificationError
from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.prediction import calc_final_errors, predict
from gridpush_drake.identification.statistics.friction_gradient import HeldFriction
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.edge_motion import simulate_near_edge
from gridpush_drake.planning.support_surface import SupportSurface, find_supported
from gridpush_drake.pushes.push_log import ObservedPush, PushLog
from tests.helpers.shapes import make_shape
from tests.identification.simulated_pokes import make_pokes

TABLE = SupportSurface.rectangle((0.0, 0.0), (1.0, 1.0))
LEARNED = 6
"""Number of pushes that are learned from; the others are predicted."""


def make_half_rough(name: str) -> tuple[GridObject, CellParameters]:
    """An object whose cells all carry the same friction: one half of it is rough and light."""
    obj = make_shape(name, 30)
    rough = obj.p_BC[:, 0] > np.median(obj.p_BC[:, 0])
    friction = np.where(rough, 0.7, 0.25)
    mass = 1 / friction
    return obj, CellParameters(0.5 * mass / mass.sum(), friction, 0.4)


def push_at_edge(obj: GridObject, truth: CellParameters, count: int, seed: int) -> PushLog:
    """Random pushes during which a part of the object hangs over the edge."""
    rng = np.random.default_rng(seed)
    pushes: list[ObservedPush] = []
    while len(pushes) < count:
        pose = np.array([rng.uniform(0.4, 0.5), rng.uniform(-0.2, 0.2), rng.uniform(-np.pi, np.pi)])
        place = rng.uniform(0, obj.edges.perimeter)
        angle = rng.uniform(-0.4, 0.4)
        push = Push.on_outline(obj, place, angle, 0.05, radius=0.01, speed=0.03, pose=pose)
        motion = simulate_near_edge(Model(obj, truth), push, pose, TABLE)
        supported = find_supported(obj, motion.poses, TABLE).mean(axis=1)
        still = np.linalg.norm(motion.final_pose - pose) < 0.02
        if motion.fell or supported.max() > 0.95 or still:
            continue
        noise = rng.standard_normal(3) * (3e-4, 3e-4, 2e-3)
        pushes.append(
            ObservedPush(
                name=f"push_{len(pushes) + 1}",
                push=push,
                pose=pose,
                t_observed=np.array([push.duration]),
                poses_observed=(motion.final_pose + noise)[None],
                overhang=True,
            )
        )
    return PushLog(tuple(pushes), table=TABLE.corners)


@pytest.mark.slow
def test_over_the_edge_pushes_are_learned_better_with_the_true_frictions() -> None:
    means = {}
    for held in (False, True):
        errors = []
        for name, seed in (("bar", 1), ("l_bracket", 1), ("claw_hammer", 0)):
            obj, truth = make_half_rough(name)
            log = push_at_edge(obj, truth, LEARNED + 4, seed)
            found = identify(
                Model(obj),
                log[:LEARNED],
                regime="quasi_static",
                friction=HeldFriction(truth.friction) if held else None,
            )
            if held:
                np.testing.assert_array_equal(found.params.friction, truth.friction)
            rest = log[LEARNED:]
            predicted = predict(Model(obj, found.params, found.physics), rest)
            errors += [one.cell for one in calc_final_errors(obj, predicted, rest)]
        means[held] = np.mean(errors)
    # 1.9 mm and 0.8 mm.
    assert means[True] < 0.6 * means[False]


def test_on_the_table_frictions_that_are_held_change_no_loads() -> None:
    obj, truth = make_half_rough("l_bracket")
    log = make_pokes(obj, truth, 4, 0, noise=(5e-4, 3e-3))
    even = identify(Model(obj), log)
    held = identify(Model(obj), log, friction=HeldFriction(truth.friction))
    np.testing.assert_allclose(
        held.posterior.calc_fraction(), even.posterior.calc_fraction(), rtol=1e-4
    )
    ratio = held.params.mass * held.params.friction / held.posterior.calc_fraction()
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e-9)


def test_frictions_that_cannot_be_held_are_refused() -> None:
    obj, truth = make_half_rough("l_bracket")
    log = make_pokes(obj, truth, 2, 0)
    for bad in (truth.friction[1:], -truth.friction, np.full(obj.n, np.nan)):
        with pytest.raises(IdentificationError, match="one for each cell"):
            identify(Model(obj), log, friction=HeldFriction(bad))
    with pytest.raises(IdentificationError, match="the method random_search cannot hold it"):
        identify(Model(obj), log, "random_search", friction=HeldFriction(truth.friction))
