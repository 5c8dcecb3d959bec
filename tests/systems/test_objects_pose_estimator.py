"""The estimator of several objects in a Diagram: a block pushes its neighbor under a camera."""

from functools import lru_cache

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, DiagramBuilder, LeafSystem
from pydrake.systems.sensors import ImageDepth32F, ImageRgba8U

from gridpush_drake.perception import KnownObject, SceneTracker
from gridpush_drake.systems import ObjectsPoseEstimator
from tests.helpers.pictures import make_camera, paint

L_SHAPE = np.array([[0, 0], [0.14, 0], [0.14, 0.04], [0.05, 0.04], [0.05, 0.12], [0, 0.12]]) - [
    0.05,
    0.04,
]
BLOCK = np.array([[-0.03, -0.02], [0.03, -0.02], [0.03, 0.02], [-0.03, 0.02]])
HEIGHT, PERIOD, WIDTH, ROWS = 0.03, 0.1, 640, 480
SPEED = np.array([0.07, 0.0, 0.0])


def calc_poses(time: float) -> np.ndarray:
    start = np.array([[-0.08, 0.0, 0.0], [0.0403, -0.015, 0.0]])
    return start + SPEED * time


@lru_cache(maxsize=8)
def take(number: int):
    poses = calc_poses(PERIOD * number)
    prisms = [(L_SHAPE, poses[0], HEIGHT, (150, 120, 80)), (BLOCK, poses[1], HEIGHT, (70, 80, 140))]
    return paint(make_camera(), prisms, seed=number)


class Player(LeafSystem):
    """Shows one painted picture after the other."""

    def __init__(self) -> None:
        super().__init__()
        for name, image in (
            ("color", ImageRgba8U(WIDTH, ROWS)),
            ("depth", ImageDepth32F(WIDTH, ROWS)),
        ):
            self.DeclareAbstractOutputPort(
                name, lambda image=image: Value(image), getattr(self, f"_show_{name}")
            )

    def _show_color(self, context: Context, output) -> None:
        image = ImageRgba8U(WIDTH, ROWS)
        image.mutable_data[..., :3] = take(round(context.get_time() / PERIOD)).color
        output.set_value(image)

    def _show_depth(self, context: Context, output) -> None:
        image = ImageDepth32F(WIDTH, ROWS)
        image.mutable_data[..., 0] = take(round(context.get_time() / PERIOD)).depth
        output.set_value(image)


def make_run(latency: float = 0.0):
    builder = DiagramBuilder()
    player = builder.AddSystem(Player())
    objects = [KnownObject(L_SHAPE, HEIGHT, "elbow"), KnownObject(BLOCK, HEIGHT, "block")]
    estimator = builder.AddSystem(
        ObjectsPoseEstimator(
            SceneTracker(objects, make_camera()),
            WIDTH,
            ROWS,
            period=PERIOD,
            latency=latency,
            guesses=list(calc_poses(0.0)),
        )
    )
    for name in ("color", "depth"):
        builder.Connect(player.GetOutputPort(name), estimator.GetInputPort(f"{name}_image"))
    return estimator, Simulator(builder.Build())


def read(estimator, root, port):
    return estimator.GetOutputPort(port).Eval(estimator.GetMyContextFromRoot(root))


def test_each_object_has_a_port_of_its_own():
    estimator, simulator = make_run(latency=0.05)
    simulator.AdvanceTo(0.26)
    root = simulator.get_context()
    for i, true in enumerate(calc_poses(0.2)):
        off = read(estimator, root, f"object_pose_{i}") - true
        assert np.hypot(*off[:2]) < 6e-4
        assert abs(off[2]) < np.radians(0.4)
        assert read(estimator, root, f"seen_{i}")[0] == 1
        covariance = read(estimator, root, f"covariance_{i}").reshape(3, 3)
        assert np.linalg.eigvalsh(covariance)[0] > 0
    assert read(estimator, root, "message") == ""
    # a clone of the Context goes on by itself
    clone = Simulator(simulator.get_system(), root.Clone())
    clone.AdvanceTo(0.36)
    simulator.AdvanceTo(0.36)
    for i in range(2):
        np.testing.assert_array_equal(
            read(estimator, simulator.get_context(), f"object_pose_{i}"),
            read(estimator, clone.get_context(), f"object_pose_{i}"),
        )


def test_nothing_is_told_before_the_latency():
    estimator, simulator = make_run(latency=0.25)
    simulator.Initialize()
    root = simulator.get_context()
    assert np.isnan(read(estimator, root, "object_pose_1")).all()
    assert read(estimator, root, "seen_0")[0] == 0


@pytest.mark.parametrize("name", ["object_pose_0", "covariance_1", "seen_0", "message"])
def test_output_ports_depend_on_state_and_time_alone(name):
    estimator, _ = make_run()
    assert not estimator.HasDirectFeedthrough(estimator.GetOutputPort(name).get_index())
