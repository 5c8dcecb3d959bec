"""The estimator predicts what a push does to a square that the arm hides meanwhile."""

from functools import lru_cache

import numpy as np
import pytest
import shapely
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.geometry.se2 import wrap_angle
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.perception.tracking.pose_prediction import PushModel
from gridpush_drake.perception.tracking.tracking import PoseTracker
from gridpush_drake.systems import ObjectPoseEstimator
from tests.helpers.hidden_pictures import ARM, HEIGHT, PERIOD, ROWS, WIDTH, HiddenPictures
from tests.helpers.pictures import make_camera

SQUARE = np.array([[-0.05, -0.05], [0.05, -0.05], [0.05, 0.05], [-0.05, 0.05]])
OBJ = GridObject.from_outline(shapely.Polygon(SQUARE), max_cells=25, name="square")
PARAMS = CellParameters.uniform(OBJ)
START = np.array([0.0, -0.02, 0.0])
RADIUS = 0.006


@lru_cache(maxsize=1)
def push():
    """A tip that turns the square about a corner, by more than an eighth of a turn."""
    count = 15
    t = PERIOD * np.arange(1, count + 1)
    along = np.linspace(0.0, 0.095, count)
    xy = np.column_stack([np.full(count, START[0] + 0.042), START[1] - 0.0565 + along])
    path = Push.along(t, xy, RADIUS)
    return t, xy, simulate(Model(OBJ, PARAMS), path, START, regime="quasi_static")


def calc_pose(time: float) -> np.ndarray:
    t, _, motion = push()
    if time <= t[0]:
        return START
    k = min(np.searchsorted(motion.times, time - t[0]), len(motion.times) - 1)
    return motion.poses[k]


def run(model: PushModel | None, estimate: CellParameters | None = None):
    """The pose and its stated deviation after the hidden push."""
    builder = DiagramBuilder()
    scene = builder.AddSystem(HiddenPictures([SQUARE], lambda time: [calc_pose(time)], push()[:2]))
    estimator = builder.AddSystem(
        ObjectPoseEstimator(
            PoseTracker(SQUARE, HEIGHT, make_camera()),
            WIDTH,
            ROWS,
            period=PERIOD,
            guess=START,
            occluded_by=[ARM],
            model=model,
        )
    )
    for name in ("color", "depth", "label"):
        builder.Connect(scene.GetOutputPort(name), estimator.GetInputPort(f"{name}_image"))
    if model is not None:
        builder.Connect(scene.GetOutputPort("tip"), estimator.GetInputPort("pusher_state"))
    if estimate is not None:
        for name, value in (
            ("mass", estimate.mass),
            ("friction", estimate.friction),
            ("contact_friction", [estimate.contact_friction]),
        ):
            source = builder.AddSystem(ConstantVectorSource(np.array(value)))
            builder.Connect(source.get_output_port(), estimator.GetInputPort(name))
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(1.75)
    context = estimator.GetMyContextFromRoot(simulator.get_context())
    pose = estimator.GetOutputPort("object_pose").Eval(context)
    covariance = estimator.GetOutputPort("covariance").Eval(context).reshape(3, 3)
    return pose, float(np.sqrt(covariance[2, 2]))


@pytest.mark.parametrize("estimate", [None, PARAMS], ids=["even", "estimate"])
def test_a_square_that_was_turned_out_of_sight_is_told_by_the_model(estimate):
    true = calc_pose(1.7)
    turned = true[2] - START[2]
    assert np.radians(50) < turned < np.radians(85)
    pose, deviation = run(PushModel(OBJ, HEIGHT, RADIUS), estimate)
    np.testing.assert_allclose(pose, true, atol=5e-3)
    # a model is believed to a part of the turn; what is left of the doubt is stated
    assert deviation < np.radians(20)


def test_without_a_model_the_side_that_is_nearer_to_the_last_pose_is_taken():
    pose, _ = run(None)
    assert abs(abs(wrap_angle(pose[2] - calc_pose(1.7)[2])) - np.pi / 2) < np.radians(3)
