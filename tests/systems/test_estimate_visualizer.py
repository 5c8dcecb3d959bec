"""What `EstimateVisualizer` keeps and draws; the pictures are drawn by a real browser."""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.common.value import AbstractValue, Value
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from gridpush_drake.display.cell_colors import CellColors
from gridpush_drake.display.server import AimCamera, StartMeshcatServer, write_recording
from gridpush_drake.display.shapes import CENTER_COLOR, PLAN_COLOR
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.robot_status import PushPhase, PushStatus
from gridpush_drake.systems.base.messages import PushCommand
from gridpush_drake.systems.learning.estimate_visualizer import EstimateVisualizer, ShownObject
from tests.helpers.chromium import find_pixels, freeze_recording, require_chromium, take_picture
from tests.helpers.made_identifications import make_block

LEARNED_AT, MOVED_AT, END = 1.0, 2.0, 3.0
"""When the estimate and the command change, and when the object has moved, s."""

HEIGHT = 0.03
RADIUS = 0.004
FIRST = np.array([0.5, 0.0, 0.0])
LAST = np.array([0.5, 0.08, 0.3])
COVARIANCE = np.diag([0.01, 0.006]) ** 2
COMMAND = PushCommand(1, 0.52, -0.04, np.pi / 2, 0.08, 0.05)

MIN_SEEN = 400
"""Pixels that something as large as a third of the object takes at least."""


@pytest.fixture(scope="module")
def obj():
    return make_block()


@pytest.fixture(scope="module")
def estimates(obj):
    """Even, and learned: the second part weighs sixteen times as much a cell as the first."""
    return CellParameters.uniform(obj), CellParameters.by_part(obj, {1: 0.01, 2: 0.16})


@pytest.fixture
def meshcat():
    server = StartMeshcatServer(0)
    AimCamera(server, [0.5, 0.0, 0.0], 0.3)
    return server


def make_diagram(
    obj, meshcat: Meshcat, estimates, optional: bool = True, body=None, **options
) -> tuple[Diagram, object]:
    builder = DiagramBuilder()
    visualizer = builder.AddSystem(
        EstimateVisualizer([ShownObject(obj, HEIGHT, body)], meshcat, **options)
    )

    def feed(port, times, values, hold=PiecewisePolynomial.ZeroOrderHold):
        source = builder.AddSystem(TrajectorySource(hold(times, np.array(values, dtype=float).T)))
        builder.Connect(source.get_output_port(), visualizer.GetInputPort(port))

    changes = [0.0, LEARNED_AT, END]
    before, after = estimates
    feed("mass", changes, [before.mass, after.mass, after.mass])
    feed("friction", changes, [before.friction, after.friction, after.friction])
    feed(
        "object_pose",
        [0.0, LEARNED_AT, MOVED_AT, END],
        [FIRST, FIRST, LAST, LAST],
        PiecewisePolynomial.FirstOrderHold,
    )
    if optional:
        centers = [params.center_of_mass(obj) for params in (before, after, after)]
        feed("center_of_mass", changes, centers)
        feed(
            "center_of_mass_covariance",
            changes,
            [COVARIANCE.ravel(), COVARIANCE.ravel() / 9, COVARIANCE.ravel() / 9],
        )
        feed("contact_friction", changes, [[0.5], [0.4], [0.4]])
        feed(
            "push_command",
            changes,
            [PushCommand().to_vector(), COMMAND.to_vector(), COMMAND.to_vector()],
        )
    return builder.Build(), visualizer


def load_drawing(visualizer, root):
    return visualizer.GetMyContextFromRoot(root).get_abstract_state(0).get_value()


def test_draws_each_estimate_and_each_push_once(obj, meshcat, estimates):
    diagram, visualizer = make_diagram(obj, meshcat, estimates)
    simulator = Simulator(diagram)
    simulator.AdvanceTo(LEARNED_AT - 0.1)
    assert meshcat.HasPath("estimate/object/0/1/cells")
    assert not meshcat.HasPath("estimate/object/0/2")
    assert not meshcat.HasPath("estimate/push")
    simulator.AdvanceTo(END - 0.1)
    assert meshcat.HasPath("estimate/object/0/2/center/edge")
    assert meshcat.HasPath("estimate/push/1/arrow")
    assert not meshcat.HasPath("estimate/object/0/3")
    assert not meshcat.HasPath("estimate/push/2")
    drawing = load_drawing(visualizer, simulator.get_context())
    assert (drawing.estimates[0].number, drawing.push) == (2, 1)
    np.testing.assert_array_equal(drawing.estimates[0].mass, estimates[1].mass)


def test_the_ghost_is_where_the_core_predicts_it_by_the_present_estimate(obj, meshcat, estimates):
    diagram, visualizer = make_diagram(obj, meshcat, estimates, pusher_radius=RADIUS)
    simulator = Simulator(diagram)
    simulator.AdvanceTo(END - 0.1)
    params = CellParameters(estimates[1].mass, estimates[1].friction, 0.4)
    push = Push(COMMAND.start, [0.0, COMMAND.speed], COMMAND.distance / COMMAND.speed, RADIUS)
    expected = simulate(Model(obj, params), push, FIRST).final_pose
    drawing = load_drawing(visualizer, simulator.get_context())
    np.testing.assert_allclose(drawing.predicted[0], expected, atol=1e-9)
    assert np.linalg.norm(drawing.predicted[0] - FIRST) > 0.01
    assert meshcat.HasPath("estimate/push/1/ghost/0")


def test_keeps_what_it_drew_in_its_context(obj, meshcat, estimates):
    diagram, visualizer = make_diagram(obj, meshcat, estimates)
    simulator = Simulator(diagram)
    simulator.AdvanceTo(LEARNED_AT - 0.1)
    copy = simulator.get_context().Clone()
    simulator.AdvanceTo(END - 0.1)
    assert load_drawing(visualizer, copy).estimates[0].number == 1
    other = Simulator(diagram, copy)
    other.get_mutable_context().SetTime(0.0)
    other.AdvanceTo(END - 0.1)
    drawings = [load_drawing(visualizer, sim.get_context()) for sim in (simulator, other)]
    np.testing.assert_array_equal(drawings[0].predicted, drawings[1].predicted)
    assert [drawing.estimates[0].number for drawing in drawings] == [2, 2]


def test_begins_anew_when_it_is_initialized(obj, meshcat, estimates):
    diagram, _ = make_diagram(obj, meshcat, estimates, path="again")
    simulator = Simulator(diagram)
    simulator.AdvanceTo(END - 0.1)
    assert meshcat.HasPath("again/object/0/2")
    simulator.get_mutable_context().SetTime(0.0)
    simulator.Initialize()
    assert meshcat.HasPath("again/object/0/1")
    assert not meshcat.HasPath("again/object/0/2")
    assert not meshcat.HasPath("again/push")


def test_needs_neither_a_center_nor_a_command(obj, meshcat, estimates):
    diagram, _ = make_diagram(obj, meshcat, estimates, optional=False, path="bare")
    context = diagram.CreateDefaultContext()
    diagram.ForcedPublish(context)
    assert meshcat.HasPath("bare/object/0/1/cells")
    assert not meshcat.HasPath("bare/object/0/1/center")


@pytest.mark.slow
def test_an_object_in_the_air_is_drawn_where_its_body_is(obj, meshcat, estimates):
    require_chromium()
    diagram, visualizer = make_diagram(obj, meshcat, estimates, optional=False, body=1)
    context = diagram.CreateDefaultContext()
    inner = visualizer.GetMyMutableContextFromRoot(context)

    def find_rows(height):
        X_WB = RigidTransform(RollPitchYaw(0.0, 0.0, 0.3), [0.5, 0.0, height])
        visualizer.GetInputPort("body_poses").FixValue(
            inner, Value[list[RigidTransform]]([RigidTransform(), X_WB])
        )
        diagram.ForcedPublish(context)
        return np.nonzero(find_colors(obj, estimates, take_picture(meshcat.web_url()))[0])[0]

    low, high = find_rows(0.0), find_rows(0.06)
    assert min(low.size, high.size) > MIN_SEEN
    assert high.mean() < low.mean() - 30  # up in the picture


@pytest.mark.parametrize("spoilt", [{"speed": 0.0}, {"distance": 0.0}])
def test_a_push_that_cannot_be_simulated_has_no_ghost(obj, meshcat, estimates, spoilt):
    command = PushCommand(**{**vars(COMMAND), **spoilt})
    diagram, visualizer = make_diagram(obj, meshcat, estimates, optional=False, path="spoilt")
    context = diagram.CreateDefaultContext()
    inner = visualizer.GetMyMutableContextFromRoot(context)
    visualizer.GetInputPort("push_command").FixValue(inner, command.to_vector())
    diagram.ForcedPublish(context)
    assert meshcat.HasPath("spoilt/push/1")
    assert not meshcat.HasPath("spoilt/push/1/ghost/0")
    assert meshcat.HasPath("spoilt/push/1/arrow") == (command.distance > 0)


def test_a_push_that_has_ended_is_not_drawn_any_more(obj, meshcat, estimates):
    """The executor is at work on it, then ready again: an old ghost tells nothing of what is next."""
    diagram, visualizer = make_diagram(obj, meshcat, estimates, path="ended", pusher_radius=RADIUS)
    simulator = Simulator(diagram)
    inner = visualizer.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    port = visualizer.GetInputPort("push_status")

    def load_after(time, status):
        port.FixValue(inner, AbstractValue.Make(status))
        simulator.AdvanceTo(time)
        return load_drawing(visualizer, simulator.get_context())

    assert load_after(LEARNED_AT + 0.2, PushStatus()).over is False
    assert meshcat.HasPath("ended/push/1/ghost/0")
    assert load_after(MOVED_AT, PushStatus(PushPhase.PUSHING, command_id=1)).over is False
    assert not meshcat.HasPath("ended/push/2")
    assert load_after(MOVED_AT + 0.2, PushStatus(command_id=1, executed=1)).over is True
    assert meshcat.HasPath("ended/push/2")  # which hides the one before it
    assert not meshcat.HasPath("ended/push/2/ghost") and not meshcat.HasPath("ended/push/2/arrow")


def test_each_of_several_objects_has_its_own_estimate_and_its_own_ghost(obj, meshcat, estimates):
    visualizer = EstimateVisualizer([ShownObject(obj, HEIGHT), ShownObject(obj, 0.02)], meshcat)
    context = visualizer.CreateDefaultContext()
    poses = np.array([FIRST, LAST])
    even, learned = estimates

    def show(second, number, predicted):
        values = {
            "object_pose": poses.ravel(),
            "mass": np.concatenate([even.mass, second.mass]),
            "friction": np.concatenate([even.friction, second.friction]),
            "center_of_mass": np.concatenate([each.center_of_mass(obj) for each in (even, second)]),
            "push_command": replace(COMMAND, command_id=number).to_vector(),
            "predicted_poses": predicted.ravel(),
        }
        for name, value in values.items():
            visualizer.GetInputPort(name).FixValue(context, value)
        simulator.AdvanceTo(context.get_time() + 0.1)

    simulator = Simulator(visualizer, context)
    context = simulator.get_mutable_context()
    show(even, 0, np.full((2, 3), np.nan))
    assert meshcat.HasPath("estimate/object/0/1/cells")
    assert meshcat.HasPath("estimate/object/1/1/center/dot")
    # what is learned of the second leaves the first one's drawing as it was
    show(learned, 1, poses + [[0.0, 0.0, 2 * np.pi], [0.05, 0.0, 0.0]])
    assert meshcat.HasPath("estimate/object/1/2/cells")
    assert not meshcat.HasPath("estimate/object/0/2")
    drawing = visualizer.GetMyContextFromRoot(context).get_abstract_state(0).get_value()
    np.testing.assert_array_equal(drawing.estimates[1].mass, learned.mass)
    # only what is expected to move has a ghost, a full turn is no motion
    assert meshcat.HasPath("estimate/push/1/ghost/1")
    assert not meshcat.HasPath("estimate/push/1/ghost/0")


@pytest.mark.slow
def test_the_ellipse_leaves_the_cells_their_colors(obj, meshcat, estimates):
    """An even object has one color, also where its center of mass may be anywhere in it."""
    require_chromium()

    def count_even(spread):
        visualizer = EstimateVisualizer([ShownObject(obj, HEIGHT)], meshcat)
        context = visualizer.CreateDefaultContext()
        values = {"object_pose": FIRST, "mass": estimates[0].mass}
        values |= {"friction": estimates[0].friction, "center_of_mass": [0.06, 0.03]}
        values["center_of_mass_covariance"] = spread.ravel()
        for name, value in values.items():
            visualizer.GetInputPort(name).FixValue(context, value)
        visualizer.ForcedPublish(context)
        return find_colors(obj, estimates, take_picture(meshcat.web_url()))[0].sum()

    bare = count_even(np.zeros((2, 2)))
    covered = count_even(np.diag([0.05, 0.025]) ** 2)  # all of the object lies within two sigma
    assert bare > MIN_SEEN
    assert covered > 0.85 * bare


def find_colors(obj, estimates, picture):
    """Pixels in the colors of the even cells, and of the learned light and heavy ones."""
    colors = CellColors()
    even = colors.calc_colors(estimates[0].mass, estimates[0].friction)[0]
    learned = colors.calc_colors(estimates[1].mass, estimates[1].friction)
    light, heavy = learned[obj.labels == 1][0], learned[obj.labels == 2][0]
    return [find_pixels(picture, color) for color in (even, light, heavy)]


def check_before(obj, estimates, picture):
    even, light, heavy = (found.sum() for found in find_colors(obj, estimates, picture))
    assert even > MIN_SEEN
    assert max(light, heavy) < MIN_SEEN / 10


def check_after(obj, estimates, picture):
    even, light, heavy = find_colors(obj, estimates, picture)
    assert min(light.sum(), heavy.sum()) > MIN_SEEN
    assert even.sum() < MIN_SEEN / 10
    assert (
        np.nonzero(heavy)[1].mean() > np.nonzero(light)[1].mean() + 20
    )  # the heavy end is the right one


@pytest.mark.slow
def test_the_live_page_shows_the_cells_in_the_colors_of_their_estimate(obj, meshcat, estimates):
    require_chromium()
    diagram, _ = make_diagram(obj, meshcat, estimates)
    simulator = Simulator(diagram)
    simulator.AdvanceTo(END - 0.1)
    check_after(obj, estimates, take_picture(meshcat.web_url(), size=(800, 600)))


@pytest.mark.slow
def test_the_live_page_changes_when_the_estimate_does(obj, meshcat, estimates):
    require_chromium()
    diagram, _ = make_diagram(obj, meshcat, estimates)
    simulator = Simulator(diagram)
    simulator.AdvanceTo(LEARNED_AT - 0.1)
    picture = take_picture(meshcat.web_url())
    check_before(obj, estimates, picture)
    assert not find_pixels(picture, color_of(PLAN_COLOR)).any()
    assert find_pixels(picture, color_of(CENTER_COLOR)).sum() > 50
    simulator.AdvanceTo(END - 0.1)
    picture = take_picture(meshcat.web_url())
    check_after(obj, estimates, picture)
    assert find_pixels(picture, color_of(PLAN_COLOR)).sum() > 100


def color_of(rgba):
    return rgba.r(), rgba.g(), rgba.b()


@pytest.mark.slow
@pytest.mark.parametrize("recorded_from", ["before", "after"])
def test_the_recording_changes_its_colors_as_the_estimate_improves(
    obj, meshcat, estimates, tmp_path, recorded_from
):
    """Whether the recording is begun before the Simulator is initialized or after."""
    require_chromium()
    empty = len(meshcat.StaticHtml())
    diagram, _ = make_diagram(obj, meshcat, estimates)
    simulator = Simulator(diagram)
    if recorded_from == "before":
        meshcat.StartRecording(30.0)
    simulator.Initialize()
    if recorded_from == "after":
        meshcat.StartRecording(30.0)
    simulator.AdvanceTo(END - 0.1)
    path = tmp_path / "recording.html"
    write_recording(meshcat, path)
    assert path.stat().st_size < empty + 200_000

    def picture_at(time):
        return take_picture(freeze_recording(path, time, tmp_path / "still.html"))

    for time in (0.0, LEARNED_AT - 0.1):
        check_before(obj, estimates, picture_at(time))
    middle = picture_at(LEARNED_AT + 0.15)
    check_after(obj, estimates, middle)
    end = take_picture(path, virtual_time=20_000)
    check_after(obj, estimates, end)
    rows = [
        np.nonzero(find_colors(obj, estimates, picture)[2])[0].mean() for picture in (middle, end)
    ]
    assert rows[1] < rows[0] - 30  # the object moves away from the camera, up in the picture
