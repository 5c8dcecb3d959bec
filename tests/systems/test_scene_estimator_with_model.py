"""The estimator foretells what a push through one object does to another, while the arm hides both."""

from functools import lru_cache

import numpy as np
import pytest
import shapely
from pydrake.common.value import Value
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, DiagramBuilder, LeafSystem
from pydrake.systems.sensors import ImageDepth32F, ImageLabel16I, ImageRgba8U

from gridpush_drake.dynamics.motion import MotionStatus
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.scene.bodies import Scene
from gridpush_drake.dynamics.scene.simulation import simulate_scene
from gridpush_drake.geometry.se2 import wrap_angle
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.perception import KnownObject, SceneTracker
from gridpush_drake.perception.foresight import ScenePushModel
from gridpush_drake.systems import ObjectsPoseEstimator
from tests.helpers.pictures import make_camera, paint

SQUARE = GridObject.from_outline(shapely.box(-0.05, -0.05, 0.05, 0.05), max_cells=25, name="square")
BLOCK = GridObject.from_outline(shapely.box(-0.03, -0.02, 0.03, 0.02), max_cells=20, name="block")
START = np.array([[0.0, -0.02, 0.0], [-0.02, 0.07, 0.2]])
SCENE = Scene(
    [(obj, CellParameters.uniform(obj), q) for obj, q in zip((SQUARE, BLOCK), START, strict=True)]
)
HEIGHT, RADIUS, PERIOD, ARM = 0.03, 0.006, 0.1, 7
WIDTH, ROWS = 640, 480
HIDDEN = (0.05, 1.65)
"""When the arm hides everything, s."""


@lru_cache(maxsize=1)
def push():
    """A tip that turns the square about a corner, and shoves the block with it."""
    count = 15
    t = PERIOD * np.arange(1, count + 1)
    along = np.linspace(0.0, 0.11, count)
    xy = np.column_stack([np.full(count, 0.042), START[0, 1] - 0.0565 + along])
    motion = simulate_scene(SCENE, Push.along(t, xy, RADIUS))
    assert motion.status == MotionStatus.OK
    return t, xy, motion


def calc_poses(time: float) -> np.ndarray:
    t, _, motion = push()
    if time <= t[0]:
        return START
    return motion.poses[min(np.searchsorted(motion.times, time - t[0]), len(motion.times) - 1)]


class Pictures(LeafSystem):
    """Pictures of the objects, labels of the arm, and the state of the tip."""

    def __init__(self) -> None:
        super().__init__()
        for name, image in (
            ("color", ImageRgba8U(WIDTH, ROWS)),
            ("depth", ImageDepth32F(WIDTH, ROWS)),
            ("label", ImageLabel16I(WIDTH, ROWS)),
        ):
            self.DeclareAbstractOutputPort(
                name, lambda image=image: Value(image), getattr(self, f"_show_{name}")
            )
        self.DeclareVectorOutputPort("tip", 6, self._show_tip)

    def _take(self, context: Context):
        time = context.get_time()
        outlines = [np.array(obj.outline.exterior.coords)[:-1] for obj in SCENE.objects]
        prisms = [
            (outline, pose, HEIGHT, (150, 120, 80))
            for outline, pose in zip(outlines, calc_poses(time), strict=True)
        ]
        return paint(make_camera(), prisms, seed=round(time / PERIOD))

    def _show_color(self, context: Context, output) -> None:
        image = ImageRgba8U(WIDTH, ROWS)
        image.mutable_data[..., :3] = self._take(context).color
        output.set_value(image)

    def _show_depth(self, context: Context, output) -> None:
        image = ImageDepth32F(WIDTH, ROWS)
        image.mutable_data[..., 0] = self._take(context).depth
        output.set_value(image)

    def _show_label(self, context: Context, output) -> None:
        image = ImageLabel16I(WIDTH, ROWS)
        hidden = HIDDEN[0] < context.get_time() < HIDDEN[1]
        image.mutable_data[:] = ARM if hidden else 1
        output.set_value(image)

    def _show_tip(self, context: Context, output) -> None:
        t, xy, _ = push()
        place = [np.interp(context.get_time(), t, xy[:, i]) for i in range(2)]
        output.SetFromVector([*place, 0.01, 0.0, 0.0, 0.0])


def run(model: ScenePushModel | None, covered_from: float = np.inf):
    """The poses after the hidden push."""
    builder = DiagramBuilder()
    pictures = builder.AddSystem(Pictures())
    known = [KnownObject(obj.outline, HEIGHT, obj.name) for obj in SCENE.objects]
    estimator = builder.AddSystem(
        ObjectsPoseEstimator(
            SceneTracker(known, make_camera()),
            WIDTH,
            ROWS,
            period=PERIOD,
            guesses=list(START),
            hidden_by=[ARM],
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


def test_objects_that_a_push_took_out_of_sight_are_told_by_the_model():
    true = calc_poses(1.7)
    moved = true - START
    assert np.radians(50) < moved[0, 2] < np.radians(85)
    assert np.linalg.norm(moved[1, :2]) > 0.03  # by the square alone: the tip is not near it
    poses = run(ScenePushModel(SCENE, top=HEIGHT, radius=RADIUS))
    np.testing.assert_allclose(poses[:, :2], true[:, :2], atol=3e-3)
    assert np.abs(wrap_angle(poses[:, 2] - true[:, 2])).max() < np.radians(2)


def test_without_a_model_the_side_that_is_nearer_to_the_last_pose_is_taken():
    poses = run(None)
    off = abs(float(wrap_angle(poses[0, 2] - calc_poses(1.7)[0, 2])))
    assert off == pytest.approx(np.pi / 2, abs=np.radians(3))


def test_a_covered_lens_sees_nothing():
    assert np.isnan(run(None, covered_from=0.35)).all()
