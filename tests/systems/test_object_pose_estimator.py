"""The estimator in a Diagram: a block slides under a camera that looks straight down, drawn ray by ray."""

from functools import lru_cache

import numpy as np
import pytest
import shapely
from pydrake.common.value import Value
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, DiagramBuilder, LeafSystem
from pydrake.systems.sensors import ImageDepth32F, ImageLabel16I, ImageRgba8U

from gridpush_drake.geometry.se2 import transform_back
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.perception.images.camera import Camera
from gridpush_drake.perception.images.frames import Frame
from gridpush_drake.perception.tracking.pose_prediction import PushModel, Tip
from gridpush_drake.perception.tracking.tracking import PoseTracker
from gridpush_drake.systems.sensing.object_pose_estimator import ObjectPoseEstimator
from gridpush_drake.systems.sensing.rgbd_noise import RgbdNoise

WIDTH, HEIGHT, FOCAL, ABOVE = 320, 240, 380.0, 0.6
OUTLINE = shapely.Polygon(
    [[-0.06, -0.03], [0.06, -0.03], [0.06, 0.0], [-0.02, 0.0], [-0.02, 0.04], [-0.06, 0.04]]
)
shapely.prepare(OUTLINE)
THICKNESS, PERIOD, SPEED, TURN = 0.03, 0.1, 0.03, 0.3
ARM = 7
K = [[FOCAL, 0, (WIDTH - 1) / 2], [0, FOCAL, (HEIGHT - 1) / 2], [0, 0, 1]]
X_WC = [[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, ABOVE], [0, 0, 0, 1]]
CAMERA = Camera(WIDTH, HEIGHT, np.array(K), np.zeros(0), np.array(X_WC, dtype=float))
PIXELS = np.stack(np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT)), axis=-1)


def calc_pose(time: float) -> np.ndarray:
    return np.array([-0.03 + SPEED * time, 0.01, 0.2 + TURN * time])


@lru_cache(maxsize=32)
def find_block(time: float) -> np.ndarray:
    """The fraction of each pixel that is block."""
    q, subpixels = calc_pose(time), []
    for dx, dy in ((-0.25, -0.25), (0.25, -0.25), (-0.25, 0.25), (0.25, 0.25)):
        xy = transform_back(q, CAMERA.cast(PIXELS + (dx, dy), THICKNESS).reshape(-1, 2))
        subpixels.append(shapely.contains_xy(OUTLINE, xy[:, 0], xy[:, 1]).reshape(HEIGHT, WIDTH))
    return np.mean(subpixels, axis=0)


class Painter(LeafSystem):
    """Draws color, depth and labels; from `arm_from` on an arm lies across all of the picture."""

    def __init__(self, arm_from: float) -> None:
        super().__init__()
        self._arm_from = arm_from
        for name, image in (
            ("color", ImageRgba8U(WIDTH, HEIGHT)), ("depth", ImageDepth32F(WIDTH, HEIGHT)),
            ("label", ImageLabel16I(WIDTH, HEIGHT)),
        ):  # fmt: skip
            self.DeclareAbstractOutputPort(
                name, lambda image=image: Value(image), getattr(self, f"_draw_{name}")
            )

    def _draw_color(self, context: Context, output) -> None:
        fraction, image = find_block(context.get_time())[..., None], ImageRgba8U(WIDTH, HEIGHT)
        image.mutable_data[..., :3] = np.rint(
            fraction * (120, 30, 30) + (1 - fraction) * (200, 170, 130)
        )
        image.mutable_data[..., 3] = 255
        output.set_value(image)

    def _draw_depth(self, context: Context, output) -> None:
        image = ImageDepth32F(WIDTH, HEIGHT)
        image.mutable_data[..., 0] = ABOVE - THICKNESS * (find_block(context.get_time()) >= 0.5)
        output.set_value(image)

    def _draw_label(self, context: Context, output) -> None:
        image = ImageLabel16I(WIDTH, HEIGHT)
        image.mutable_data[:] = ARM if context.get_time() >= self._arm_from else 1
        output.set_value(image)


class Run:
    """A Diagram in its Simulator."""

    def __init__(self, latency: float = 0.0, arm_from: float = np.inf, guess=None) -> None:
        builder = DiagramBuilder()
        painter = builder.AddSystem(Painter(arm_from))
        noise = builder.AddSystem(
            RgbdNoise(WIDTH, HEIGHT, PERIOD, depth_noise=0.001, color_noise=2.0)
        )
        self.estimator = builder.AddSystem(
            ObjectPoseEstimator(
                PoseTracker(OUTLINE, THICKNESS, CAMERA),
                WIDTH,
                HEIGHT,
                period=PERIOD,
                latency=latency,
                guess=guess,
                occluded_by=[ARM],
            )
        )
        for name in ("color", "depth"):
            builder.Connect(painter.GetOutputPort(name), noise.GetInputPort(f"{name}_image"))
            builder.Connect(
                noise.GetOutputPort(f"{name}_image"), self.estimator.GetInputPort(f"{name}_image")
            )
        builder.Connect(painter.GetOutputPort("label"), self.estimator.GetInputPort("label_image"))
        self.simulator = Simulator(builder.Build())
        self.root = self.simulator.get_mutable_context()

    def at(self, time: float, port: str = "object_pose", root: Context | None = None):
        if root is None:
            self.simulator.AdvanceTo(time)
        return self.estimator.GetOutputPort(port).Eval(
            self.estimator.GetMyContextFromRoot(root or self.root)
        )


def check(pose, time: float) -> None:
    off = pose - calc_pose(time)
    assert np.linalg.norm(off[:2]) < 1e-3 and abs(off[2]) < np.radians(1.0), off


def test_follows_the_object_from_the_first_picture_on():
    run = Run()
    run.simulator.Initialize()
    check(run.at(0.0), 0.0)
    for time in (0.35, 1.05):
        check(run.at(time), np.floor(time / PERIOD) * PERIOD)
        covariance = run.at(time, "covariance").reshape(3, 3)
        assert (np.sqrt(np.diag(covariance)) < (2e-3, 2e-3, 0.03)).all() and np.linalg.eigvalsh(
            covariance
        )[0] > 0
    assert run.at(1.05, "seen")[0] == 1 and run.at(1.05, "message") == ""


def test_what_a_picture_tells_is_there_after_the_latency():
    run = Run(latency=0.25, guess=calc_pose(0.0))
    assert np.isnan(run.at(0.2)).all() and run.at(0.2, "seen")[0] == 0
    check(run.at(0.26), 0.0)
    check(run.at(0.86), 0.6)


@pytest.mark.slow
def test_nothing_is_seen_behind_the_arm_or_under_the_lid():
    run = Run(arm_from=0.45)
    check(run.at(0.41), 0.4)
    hidden = run.at(0.51)
    spread = np.sqrt(np.diag(run.at(0.51, "covariance").reshape(3, 3)))
    assert np.isnan(hidden).all() or (spread > 0.01).any(), "not seen, or known to be hardly seen"
    run = Run()
    check(run.at(0.15), 0.1)
    run.estimator.SetCovered(run.root, True)
    assert np.isnan(run.at(0.25)).all() and np.isnan(run.at(0.25, "covariance")).all()
    run.estimator.SetCovered(run.root, False)
    check(run.at(0.35), 0.3)


def test_a_clone_sees_the_same():
    run = Run()
    run.at(0.25)
    clone = run.root.Clone()
    other = Simulator(run.simulator.get_system(), clone)
    other.AdvanceTo(0.55)
    np.testing.assert_array_equal(run.at(0.55), run.at(0.55, root=other.get_context()))


def test_an_object_of_another_outline_is_not_taken_for_it():
    run = Run()
    tracker = PoseTracker(shapely.box(-0.02, -0.02, 0.02, 0.02), THICKNESS, CAMERA)
    run.estimator._tracker = tracker
    run.simulator.Initialize()
    assert np.isnan(run.at(0.0)).all()
    assert run.at(0.0, "message")


@pytest.mark.parametrize("name", ["object_pose", "covariance", "seen", "message"])
def test_output_ports_depend_on_state_and_time_alone(name):
    run = Run()
    assert not run.estimator.HasDirectFeedthrough(run.estimator.GetOutputPort(name).get_index())


@pytest.mark.parametrize(("tip", "seen"), [((0.3, 0.0, 0.2), False), ((0.04, 0.02, 0.01), True)])
def test_an_object_that_seems_to_jump_where_the_finger_is_not_is_not_seen(tip, seen):
    """The block is at rest but for its last picture, in which an arm covers a part of it."""
    obj = GridObject.from_outline(np.array(OUTLINE.exterior.coords)[:-1], max_cells=20, name="L")
    tracker = PoseTracker(OUTLINE, THICKNESS, CAMERA)
    model = PushModel(obj, top=THICKNESS, radius=0.008)
    estimator = ObjectPoseEstimator(tracker, WIDTH, HEIGHT, model=model)
    place = Tip(0.0, np.array(tip))

    def take(time: float, covered) -> None:
        nonlocal state, found
        fraction = find_block(time)[..., None]
        color = np.rint(fraction * (120, 30, 30) + (1 - fraction) * (200, 170, 130)).astype(
            np.uint8
        )
        frame = Frame(color, None, time)
        state = state or tracker.start(frame, calc_pose(0.0))
        state, (found,) = estimator._track(state, frame, covered, None, place)

    state, found = None, None
    take(0.0, None)
    assert found.seen
    covered = np.zeros((HEIGHT, WIDTH), dtype=bool)
    covered[:, : WIDTH // 2 - 60] = True
    take(0.2, covered)
    assert found.seen == seen
    take(0.3, None)
    check(found.pose, 0.3)
