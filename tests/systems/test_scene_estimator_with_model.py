"""The estimator predicts what a push through one object does to another, while the arm hides both."""

from functools import lru_cache

import numpy as np
import pytest
import shapely
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from gridpush_drake.dynamics.motion import MotionStatus
from gridpush_drake.dynamics.push import Push
from gridpush_drake.geometry.se2 import wrap_angle
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.perception import KnownObject, SceneTracker
from gridpush_drake.perception.tracking.pose_prediction import ScenePushModel
from gridpush_drake.systems import ObjectsPoseEstimator
from tests.helpers.hidden_pictures import ARM, HEIGHT, PERIOD, ROWS, WIDTH, HiddenPictures
from tests.helpers.pictures import make_camera
from tests.helpers.scene_cases import Layout

SQUARE = GridObject.from_outline(shapely.box(-0.05, -0.05, 0.05, 0.05), max_cells=25, name="square")
BLOCK = GridObject.from_outline(shapely.box(-0.03, -0.02, 0.03, 0.02), max_cells=20, name="block")
START = np.array([[0.0, -0.02, 0.0], [-0.02, 0.07, 0.2]])
SCENE = Layout.of(
    [(obj, CellParameters.uniform(obj), q) for obj, q in zip((SQUARE, BLOCK), START, strict=True)]
)
RADIUS = 0.006


@lru_cache(maxsize=1)
def push():
    """A tip that turns the square about a corner, and shoves the block with it."""
    count = 15
    t = PERIOD * np.arange(1, count + 1)
    along = np.linspace(0.0, 0.11, count)
    xy = np.column_stack([np.full(count, 0.042), START[0, 1] - 0.0565 + along])
    motion = SCENE.simulate(Push.along(t, xy, RADIUS))
    assert motion.status == MotionStatus.OK
    return t, xy, motion


def calc_poses(time: float) -> np.ndarray:
    t, _, motion = push()
    if time <= t[0]:
        return START
    return motion.poses[min(np.searchsorted(motion.times, time - t[0]), len(motion.times) - 1)]


def run(model: ScenePushModel | None, covered_from: float = np.inf):
    """The poses after the hidden push."""
    builder = DiagramBuilder()
    outlines = [np.array(obj.outline.exterior.coords)[:-1] for obj in SCENE.objects]
    pictures = builder.AddSystem(HiddenPictures(outlines, calc_poses, push()[:2]))
    known = [KnownObject(obj.outline, HEIGHT, obj.name) for obj in SCENE.objects]
    estimator = builder.AddSystem(
        ObjectsPoseEstimator(
            SceneTracker(known, make_camera()),
            WIDTH,
            ROWS,
            period=PERIOD,
            guesses=list(START),
            occluded_by=[ARM],
            model=model,
        )
    )
    for name in ("color", "depth", "label"):
        builder.Connect(pictures.GetOutputPort(name), estimator.GetInputPort(f"{name}_image"))
    if model is not None:
        builder.Connect(pictures.GetOutputPort("tip"), estimator.GetInputPort("pusher_state"))
    simulator = Simulator(builder.Build())
    for time in (min(covered_from, 1.75), 1.75):
        simulator.AdvanceTo(time)
        estimator.SetCovered(simulator.get_mutable_context(), time >= covered_from)
    context = estimator.GetMyContextFromRoot(simulator.get_context())
    return np.array([estimator.GetOutputPort(f"object_pose_{i}").Eval(context) for i in range(2)])


@pytest.mark.slow
def test_objects_that_a_push_took_out_of_sight_are_told_by_the_model():
    true = calc_poses(1.7)
    moved = true - START
    assert np.radians(50) < moved[0, 2] < np.radians(85)
    assert np.linalg.norm(moved[1, :2]) > 0.03  # by the square alone: the tip is not near it
    poses = run(ScenePushModel(SCENE.bodies, top=HEIGHT, radius=RADIUS))
    np.testing.assert_allclose(poses[:, :2], true[:, :2], atol=3e-3)
    assert np.abs(wrap_angle(poses[:, 2] - true[:, 2])).max() < np.radians(2)


def test_without_a_model_the_side_that_is_nearer_to_the_last_pose_is_taken():
    poses = run(None)
    off = abs(float(wrap_angle(poses[0, 2] - calc_poses(1.7)[0, 2])))
    assert off == pytest.approx(np.pi / 2, abs=np.radians(3))


def test_a_covered_lens_sees_nothing():
    assert np.isnan(run(None, covered_from=0.35)).all()
