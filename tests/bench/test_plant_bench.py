"""Drake's plant and the grid LCP agree on where a push ends."""

from itertools import chain

import numpy as np
import pytest

from gridpush_drake.bench.worlds.plant import (
    DEFAULT_OBJECTS,
    PlantJob,
    PlantWorld,
    draw_push,
    make_jobs,
    make_table,
    run_job,
)
from gridpush_drake.dynamics.physics import Physics
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import ObjectError, PushError
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.parameters import CellParameters
from tests.helpers.shapes import make_shape

MAX_POSITION, MAX_ANGLE = 1e-3, np.radians(0.5)
"""m and rad, between the last poses after a push of 10 cm."""


@pytest.fixture(scope="module")
def obj():
    return make_shape("l_bracket", 40)


@pytest.fixture(scope="module")
def params(obj):
    rng = np.random.default_rng(2)
    return CellParameters(rng.uniform(0.005, 0.03, obj.n), rng.uniform(0.2, 0.6, obj.n), 0.45)


def test_one_push_ends_where_the_model_has_it(obj, params):
    push, pose = draw_push(Model(obj, params), 7, 0.01)
    world = PlantWorld(Model(obj, params), pose, radius=0.01)
    world.execute(push)
    motion = world.truth.motion
    expected = simulate(
        Model(obj, params, Physics(regime="inertial", spin="none")), push, pose, 1e-3
    )
    assert world.tracking_error < 1e-5
    assert np.linalg.norm(motion.poses[-1, :2] - pose[:2]) > 0.01
    np.testing.assert_allclose(motion.poses[-1], expected.final_pose, rtol=0, atol=3e-4)
    # and all along the way
    np.testing.assert_allclose(motion.poses, expected.poses, rtol=0, atol=1e-3)


def test_a_plant_pushes_again_the_same(obj, params):
    world = PlantWorld(Model(obj, params), radius=0.01)
    push = Push.on_outline(obj, 0.02, 0.1, 0.02, radius=0.01, speed=0.1)
    world.execute(push)
    first = world.truth.motion
    world.set_params(CellParameters.uniform(obj))
    world.put((0.1, 0.1, 1.0))
    world.execute(push)
    world.set_params(params)
    world.put((0.0, 0.0, 0.0))
    world.execute(push)
    np.testing.assert_array_equal(world.truth.motion.poses, first.poses)
    assert np.linalg.norm(first.poses[-1]) > 1e-3
    with pytest.raises(PushError, match="radius"):
        world.execute(Push.on_outline(obj, 0.02, 0.1, 0.02, radius=0.02, speed=0.1))


def test_a_free_object_pushed_low_moves_as_the_model_has_it(obj, params):
    # the higher the push, the more load shifts to the cells in front
    push = Push.on_outline(obj, 0.02, 0.3, 0.03, radius=0.01, speed=0.05)
    expected = simulate(
        Model(obj, params, Physics(regime="inertial", spin="none")), push, dt=2e-3
    ).final_pose
    worlds = [
        PlantWorld(Model(obj, params), radius=0.01, base="free", push_height=z)
        for z in (5e-4, 0.02)
    ]
    for world in worlds:
        world.execute(push)
    low, high = (np.abs(world.truth.pose - expected) for world in worlds)
    assert np.linalg.norm(low[:2]) < 2e-4 and low[2] < np.radians(0.2)
    assert np.linalg.norm(high[:2]) > 5 * np.linalg.norm(low[:2])


def test_tables_and_names():
    with pytest.raises(ObjectError, match="spanner"):
        make_jobs(("spanner",), 1, ("planar",), 0)
    scores = run_job(PlantJob("toolbox", "planar", (4,)))
    table = make_table(scores)
    assert [row[:4] for row in table.rows] == [
        ["toolbox", "planar", "none", 1],
        ["toolbox", "planar", "coupled", 1],
    ]
    assert scores[0].position < MAX_POSITION


@pytest.mark.slow
def test_plant_and_model_agree():
    for score in chain(*map(run_job, make_jobs(DEFAULT_OBJECTS, 3, ("planar",), 100))):
        assert score.tracking_error < 2e-5
        assert score.position < MAX_POSITION, score
        assert score.angle < MAX_ANGLE, score


@pytest.mark.slow
def test_a_free_base_differs_by_the_loads_that_shift():
    scores = list(chain(*map(run_job, make_jobs(("claw_hammer", "toolbox"), 3, ("free",), 0))))
    assert max(score.position for score in scores) < 5e-3
    assert max(score.tilt for score in scores) < 1e-3
