"""The detector in a Diagram: a block under a camera that looks straight down, drawn ray by ray."""

from functools import lru_cache

import numpy as np
import pytest
import shapely
from pydrake.common.value import Value
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, DiagramBuilder
from pydrake.systems.primitives import ConstantValueSource
from pydrake.systems.sensors import ImageDepth32F, ImageLabel16I, ImageRgba8U

from gridpush_drake.objects.object_file import PhysicalPrior
from gridpush_drake.perception.detection.detection import detect_object
from gridpush_drake.perception.images.frames import Frame
from gridpush_drake.systems.sensing.object_detector import (
    ObjectDetector,
    ObjectNaming,
    find_in_frame,
)
from tests.systems.test_object_pose_estimator import (
    ARM,
    CAMERA,
    HEIGHT,
    OUTLINE,
    PERIOD,
    THICKNESS,
    WIDTH,
    Painter,
    calc_pose,
)

NAMING = ObjectNaming("block", PhysicalPrior(pusher_radius=0.004), 0.2)


class Run:
    """A Diagram in its Simulator; the arm, where it is, goes away at `arm_until`."""

    def __init__(self, arm_until: float = 0.0, **options) -> None:
        builder = DiagramBuilder()
        self.painter = builder.AddSystem(Painter(-np.inf if arm_until else np.inf))
        self.arm_until = arm_until
        self.detector = builder.AddSystem(
            ObjectDetector(CAMERA, naming=NAMING, occluded_by=[ARM], period=PERIOD, **options)
        )
        for name in ("color", "depth", "label"):
            builder.Connect(
                self.painter.GetOutputPort(name), self.detector.GetInputPort(f"{name}_image")
            )
        self.simulator = Simulator(builder.Build())
        self.root = self.simulator.get_mutable_context()

    def advance(self, time: float) -> None:
        if time > self.arm_until:
            self.painter._arm_from = np.inf
        self.simulator.AdvanceTo(time)

    def read(self, port: str, root: Context | None = None):
        return self.detector.GetOutputPort(port).Eval(
            self.detector.GetMyContextFromRoot(root or self.root)
        )

    def pull(self, number: float) -> None:
        own = self.detector.GetMyMutableContextFromRoot(self.root)
        self.detector.GetInputPort("trigger").FixValue(own, [number])


@lru_cache(maxsize=8)
def detect(time: float):
    """What `detect_object` makes of the picture of a time, without an arm."""
    painter = Painter(np.inf)
    context = painter.CreateDefaultContext()
    context.SetTime(time)
    color, depth = (painter.GetOutputPort(name).Eval(context).data for name in ("color", "depth"))
    return detect_object(color[..., :3].copy(), depth[..., 0].copy(), CAMERA)


def same(run: Run, expected) -> None:
    found = run.read("detection").detected
    assert (
        shapely.equals_exact(found.outline, expected.outline, 0.0)
        and found.height == expected.height
    )
    np.testing.assert_array_equal(found.mask, expected.mask)
    np.testing.assert_array_equal(run.read("object_pose"), [*expected.X_WB[:2], NAMING.heading])
    np.testing.assert_array_equal(found.X_WB, run.read("object_pose"))


def test_finds_what_the_function_finds_bit_for_bit_in_the_first_picture():
    run = Run()
    run.simulator.Initialize()
    assert run.read("found")[0] == 1 and run.read("message") == ""
    same(run, detect(0.0))
    obj = run.read("detection").obj
    assert (
        obj.name == "block"
        and obj.prior == NAMING.prior
        and obj.height == pytest.approx(THICKNESS, abs=1e-4)
    )
    assert obj.outline.area == pytest.approx(OUTLINE.area, rel=0.02)
    x, y, _ = calc_pose(0.0)
    middle = np.array(OUTLINE.centroid.coords[0])
    c, s = np.cos(0.2), np.sin(0.2)
    np.testing.assert_allclose(
        run.read("object_pose")[:2], [x, y] + np.array([[c, -s], [s, c]]) @ middle, atol=1e-3
    )


@pytest.mark.slow
def test_looks_once_or_when_it_is_triggered_or_always():
    run, always = Run(), Run(once=False)
    for one in (run, always):
        one.advance(1.5 * PERIOD)
    same(run, detect(0.0))
    same(always, detect(PERIOD))
    run.pull(1.0)
    run.advance(2.5 * PERIOD)
    same(run, detect(2 * PERIOD))
    run.pull(float("nan"))
    run.advance(4.5 * PERIOD)
    same(run, detect(2 * PERIOD))


def test_looks_until_the_arm_is_gone():
    run = Run(arm_until=0.25)
    run.advance(0.15)
    assert (
        run.read("found")[0] == 0
        and run.read("detection").obj is None
        and run.read("detection").detected is None
    )
    assert "hides all" in run.read("message") and np.isnan(run.read("object_pose")).all()
    run.advance(0.35)
    assert run.read("found")[0] == 1 and run.read("message") == ""


@pytest.mark.slow
def test_an_object_of_which_the_robot_hides_a_part_is_not_taken_for_a_smaller_one():
    painter = Painter(np.inf)
    images = [
        painter.GetOutputPort(name).Eval(painter.CreateDefaultContext()).data
        for name in ("color", "depth")
    ]
    frame = Frame(images[0][..., :3].copy(), images[1][..., 0].copy(), 0.0)
    mask = detect(0.0).mask
    columns = np.flatnonzero(mask.any(axis=0))
    middle = int(columns.mean())

    def look(hidden):
        return find_in_frame(frame, CAMERA, None, NAMING, None, hidden, seed=0)

    for first, cut in ((middle, True), (columns[-1] - 10, True), (columns[-1] + 1, False)):
        hidden = np.zeros_like(mask)
        hidden[:, first:] = True
        found = look(hidden)
        assert isinstance(found, str) == cut, first
        if cut:
            assert found == "the robot hides a part of the object; expected all of it in view"
    # A finger over the rim hides so little that its notch is let pass.
    rows = np.flatnonzero(mask[:, columns[-1]])
    hidden = np.zeros_like(mask)
    hidden[rows[0] : rows[0] + 2, columns[-1] - 2 :] = True
    assert not isinstance(look(hidden), str)


def test_beside_the_diagram_it_finds_the_same_a_delay_later_in_a_clone_too():
    run = Run(answer_delay=0.2)
    run.advance(0.15)
    assert run.read("found")[0] == 0 and run.read("message") == ""
    clone = Simulator(run.simulator.get_system(), run.root.Clone())
    clone.AdvanceTo(0.25)
    run.advance(0.25)
    same(run, detect(0.0))
    again = run.read("detection", clone.get_context()).detected
    assert shapely.equals_exact(again.outline, run.read("detection").detected.outline, 0.0)
    np.testing.assert_array_equal(again.picture, run.read("detection").detected.picture)


def paint(image, values):
    image.mutable_data[:] = values
    return image


GRAY = paint(ImageRgba8U(WIDTH, HEIGHT), 130)
FLAT = paint(ImageDepth32F(WIDTH, HEIGHT), 0.6)


@pytest.mark.parametrize(
    ("color", "depth", "label", "says"),
    [
        (ImageRgba8U(), FLAT, None, "the color image has 0x0 pixels; expected 320x240"),
        (GRAY, ImageDepth32F(8, 6), None, "the depth image has 8x6"),
        (GRAY, FLAT, ImageLabel16I(5, 5), "the label image has 5x5"),
        (GRAY, FLAT, None, "no object"),
        (GRAY, None, None, "no object"),
        (GRAY, paint(ImageDepth32F(WIDTH, HEIGHT), 600.0), None, "median is 600; expected"),
        (GRAY, paint(ImageDepth32F(WIDTH, HEIGHT), np.nan), None, "depth is measured in 0%"),
        (GRAY, paint(ImageDepth32F(WIDTH, HEIGHT), -np.inf), None, "depth is measured in 0%"),
        (GRAY, FLAT, paint(ImageLabel16I(WIDTH, HEIGHT), ARM), "the robot hides all"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_picture_is_on_the_message_port(color, depth, label, says):
    builder = DiagramBuilder()
    detector = builder.AddSystem(ObjectDetector(CAMERA, occluded_by=[ARM], period=PERIOD))
    for name, image in (("color", color), ("depth", depth), ("label", label)):
        if image is not None:
            source = builder.AddSystem(ConstantValueSource(Value(image)))
            builder.Connect(source.get_output_port(), detector.GetInputPort(f"{name}_image"))
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(1.5 * PERIOD)
    own = detector.GetMyContextFromRoot(simulator.get_context())
    message = detector.GetOutputPort("message").Eval(own)
    assert says in message and "Error" not in message, message
    assert detector.GetOutputPort("found").Eval(own)[0] == 0


@pytest.mark.parametrize("name", ["object_pose", "found", "detection", "message"])
def test_output_ports_depend_on_the_state_alone(name):
    detector = ObjectDetector(CAMERA)
    assert not detector.HasDirectFeedthrough(detector.GetOutputPort(name).get_index())
