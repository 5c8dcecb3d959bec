"""The figures: their parts, pictures of objects, models and motions, and figures of runs."""

import subprocess
import sys
from dataclasses import replace
from io import BytesIO
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pytest
import shapely
from matplotlib.colors import to_rgb
from matplotlib.patches import Circle, Patch
from PIL import Image
from shapely import Polygon

from gridpush_drake.dynamics.push import Push
from gridpush_drake.errors import ObjectError
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.statistics.outliers import Outlier
from gridpush_drake.multibody.ground_truth import sample_ground_truth
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import find_shipped_object
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.contact.trial import calc_goal_error
from gridpush_drake.planning.plausible_masses import PlausibleMassSet
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.report.draw import (
    LEARNED_COLOR,
    calc_round_length,
    draw_cells,
    draw_outline,
    draw_parts,
    make_chart,
    make_grid,
    to_png,
    to_svg,
)
from gridpush_drake.report.figures import (
    draw_model,
    draw_motion,
    draw_object,
    draw_pushes,
    draw_scene_motion,
    draw_unknown_maps,
)
from gridpush_drake.report.plan_figures import (
    CLOSE_UP,
    GraspDrawn,
    PushDrawn,
    draw_pre_grasp,
    draw_push_run,
    draw_slide,
)
from gridpush_drake.report.progress import Progress, draw_progress
from gridpush_drake.report.scene_run import draw_scene_run
from tests.helpers.made_identifications import make_block, make_identification
from tests.helpers.scene_cases import PLATE, TIPS, Layout
from tests.helpers.shapes import make_shape
from tests.helpers.simulated_pushes import make_pushes

RIGHT_HALF = [[0.1, 0], [0.2, 0], [0.2, 0.1], [0.1, 0.1]]
MANY_POSES = 60
POSES = [(0.0, 0.0, 0.0), (0.05, 0.0, 0.3), (0.1, 0.02, 0.6)]
GOAL = (0.1, 0.03, 0.7)


def make_axes():
    figure, axes = make_grid(1, 1, 6.0, 4.5)
    return figure, axes[0, 0]


def bar():
    return GridObject.from_outline(
        [[0, 0], [0.2, 0], [0.2, 0.1], [0, 0.1]], parts={4: RIGHT_HALF}, max_cells=50
    )


def test_cells_are_squares_where_they_are():
    obj = bar()
    _, ax = make_axes()
    cells = draw_cells(ax, obj)
    paths = [path.vertices[:4] for path in cells.get_paths()]
    assert len(paths) == obj.n
    np.testing.assert_allclose([corners.mean(axis=0) for corners in paths], obj.p_BC, atol=1e-12)
    np.testing.assert_allclose(np.ptp(paths[0], axis=0), obj.cell_size)
    assert ax.get_aspect() == 1.0


def test_pose_places_cells_and_outline():
    obj, pose = bar(), (0.3, -0.2, 0.8)
    _, ax = make_axes()
    cells = draw_cells(ax, obj, pose=pose)
    middles = [path.vertices[:4].mean(axis=0) for path in cells.get_paths()]
    np.testing.assert_allclose(middles, obj.cells_at(pose), atol=1e-12)
    low, high = ax.dataLim.min, ax.dataLim.max
    assert (low < obj.cells_at(pose).min(axis=0)).all() and (
        high > obj.cells_at(pose).max(axis=0)
    ).all()


def test_values_are_colored_and_labeled():
    obj = bar()
    figure, ax = make_axes()
    cells = draw_cells(ax, obj, np.arange(obj.n), label="friction")
    assert cells.get_clim() == (0, obj.n - 1)
    assert [other.get_ylabel() for other in figure.axes[1:]] == ["friction"]
    limited = draw_cells(ax, obj, np.arange(obj.n), limits=(-1, 1), cmap="magma")
    assert limited.get_clim() == (-1, 1)
    assert len(figure.axes) == 2


def test_equal_values_are_drawn():
    obj = bar()
    figure, ax = make_axes()
    draw_cells(ax, obj, np.full(obj.n, 0.3), label="friction")
    assert to_png(figure).startswith(b"\x89PNG")


def test_parts_have_a_legend_with_counts():
    obj = bar()
    figure, ax = make_axes()
    draw_parts(ax, obj)
    texts = [text.get_text() for text in ax.get_legend().get_texts()]
    assert texts == ["part 1: 25 cells", "part 4: 25 cells"]
    assert to_png(figure).startswith(b"\x89PNG")


def test_outline_has_its_holes():
    hole = [[0.05, 0.02], [0.05, 0.08], [0.15, 0.08], [0.15, 0.02]]
    obj = GridObject.from_outline(Polygon([[0, 0], [0.2, 0], [0.2, 0.1], [0, 0.1]], [hole]))
    _, ax = make_axes()
    assert len(draw_outline(ax, obj).get_path().to_polygons()) == 2


def test_pictures_of_an_object_name_its_body_frame():
    obj = GridObject.from_yaml(find_shipped_object("claw_hammer"))
    named = [text.get_text() for text in draw_object(obj).axes[0].texts]
    assert "body frame" in named and "outline's frame" not in named
    moved = draw_object(obj.place([0.01, 0.0, 0.1])).axes[0].texts
    (name,) = [text for text in moved if text.get_text() == "outline's frame"]
    assert name.xy == pytest.approx((0.01, 0.0))


def test_wrong_number_of_values_is_refused():
    _, ax = make_axes()
    with pytest.raises(ObjectError, match="one for each cell"):
        draw_cells(ax, bar(), np.ones(3))


def test_drawing_leaves_pyplot_alone():
    code = "import sys, gridpush_drake.report.draw; assert 'matplotlib.pyplot' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


def motion():
    poses = np.linspace((0, 0, 0), (0.05, 0.02, 0.4), 30)
    return draw_motion(make_block(), Push((-0.1, 0), (0.1, 0), 1.0, 0.01), poses)


def scene_motion():
    block = make_block()
    params = CellParameters.uniform(block)
    scene = Layout.of([(block, params, (0.0, 0.0, 0.0)), (block, params, (0.3, 0, 0))])
    poses = np.linspace(scene.poses, scene.poses + (0.05, 0.02, 0.4), 30)
    return draw_scene_motion(scene.objects, Push((-0.1, 0), (0.1, 0), 1.0, 0.01), poses)


@pytest.mark.parametrize(
    "draw",
    [
        lambda: draw_object(make_block()),
        lambda: draw_model(make_identification()),
        motion,
        scene_motion,
    ],
)
def test_a_notebook_shows_it_as_a_png_with_something_on_it(draw):
    with Image.open(BytesIO(draw()._repr_png_())) as image:
        assert image.format == "PNG"
        assert len(image.convert("RGB").getcolors(1 << 24)) > 10


@pytest.mark.parametrize("sides", [(1e-3, 1e-3), (5.0, 5.0), (0.02, 0.6), (0.6, 0.02)])
def test_draws_objects_of_any_size_and_shape(sides):
    x, y = sides
    obj = GridObject.from_outline([[0, 0], [x, 0], [x, y], [0, y]], max_cells=12)
    for picture in (draw_object(obj), draw_model(make_identification(obj))):
        with Image.open(BytesIO(to_png(picture))) as image:
            assert 200 < image.width < 2000
            assert 100 < image.height < 2000


@pytest.mark.parametrize(
    ("longest", "length"), [(0.12, 0.1), (0.1, 0.1), (0.099, 0.05), (0.0021, 0.002), (3.0, 2.0)]
)
def test_scale_bars_are_round(longest, length):
    assert calc_round_length(longest) == pytest.approx(length)


def draw(obj, poses, grasp=None):
    surface = SupportSurface(shapely.box(-0.5, -0.5, 0.5, 0.0))
    push = PushDrawn(np.array([-0.12, -0.3]), np.array([-0.12, -0.2]), poke=True)
    return draw_pre_grasp(
        obj,
        surface,
        poses,
        [push],
        PlausibleMassSet.of_masses(Model(obj)),
        None,
        grasp,
    )


def test_frames_everything_drawn_with_the_same_room_all_round():
    """The frame is the bounding box of discs about all points, which shapely finds slowly."""
    obj = GridObject.from_outline([[0, 0], [0.12, 0], [0.12, 0.06], [0, 0.06]], max_cells=8)
    poses = [np.array([0.0, -0.3, 0.4]), np.array([0.1, -0.2, 0.9]), np.array([0.1, -0.01, 1.5])]
    way, end = draw(obj, poses, GraspDrawn(np.array([0.1, 0.05]), -1.5)).axes
    points = np.concatenate(
        [*(obj.cells_at(pose) for pose in poses), [[-0.12, -0.3], [-0.12, -0.2]]]
    )
    slow = shapely.MultiPoint(points).buffer(CLOSE_UP).bounds
    assert (*way.get_xlim(), *way.get_ylim()) == pytest.approx([slow[0], slow[2], slow[1], slow[3]])
    low, high = end.get_xlim(), end.get_ylim()
    cells = shapely.MultiPoint(obj.cells_at(poses[-1])).buffer(CLOSE_UP).bounds
    assert low[0] <= cells[0]
    assert high[1] >= cells[3]


@pytest.mark.parametrize(
    ("margin", "says"), [(-0.018, "18 mm too little"), (0.012, "12 mm to spare")]
)
def test_the_title_of_a_slides_goal_stays_in_the_picture(margin, says):
    surface = SupportSurface.rectangle((0, 0), (0.8, 0.6))
    planner = SimpleNamespace(
        obj=make_block(),
        surface=surface,
        options=SimpleNamespace(goal=SimpleNamespace(inset=0.005)),
    )
    square = np.array([[-0.02, -0.02], [0.02, -0.02], [0.02, 0.02], [-0.02, 0.02]])
    part = SimpleNamespace(footprint=square, width=0.0644)
    goal = SimpleNamespace(pose=np.array([0.0, 0.3, 1.0]), margin=margin, part=part)
    plan = SimpleNamespace(poses=[np.zeros(3)], pushes=[], poke=None, status="failed", goal=goal)
    masses = SimpleNamespace(center_of_mass_polygon=square / 2)
    figure = draw_slide(planner, masses, plan)
    figure.canvas.draw()
    title = figure.axes[1].title
    assert title.get_text() == f"at the worst {says},\n64 mm between the jaws"
    extent = title.get_window_extent()
    assert extent.x0 >= 0 and extent.x1 <= figure.bbox.width


def test_a_pose_more_is_one_outline_more_and_not_the_objects_cells_once_more():
    obj = GridObject.from_yaml(find_shipped_object("claw_hammer"))
    rng = np.random.default_rng(0)
    poses = list(
        np.column_stack(
            [rng.uniform(-0.3, 0.3, (MANY_POSES, 2)) - (0, 0.3), rng.uniform(-3, 3, MANY_POSES)]
        )
    )
    few, many = (draw(obj, some).axes[0].get_children() for some in (poses[-2:], poses))
    assert len(many) - len(few) == MANY_POSES - 2
    outlined = [part for part in many if isinstance(part, Patch)]
    assert len(outlined) < len(obj.p_BC)


@pytest.mark.parametrize("count", [0, 1, 2])
def test_shows_every_push_and_the_errors(count):
    obj = make_shape("claw_hammer", 20)
    pushes = [Push((-0.1, 0.05 * i), (0.1, 0.0), 1.0, 0.008) for i in range(count)]
    figure = draw_push_run(
        obj, POSES[: count + 1], pushes, GOAL, expected=[0.02] * count, tolerance=0.02
    )
    way, errors = figure.axes
    circles = [patch for patch in way.patches if isinstance(patch, Circle)]
    assert [circle.center for circle in circles] == [tuple(push.start) for push in pushes]
    np.testing.assert_allclose(
        errors.lines[0].get_ydata(), 1e3 * calc_goal_error(obj, POSES[: count + 1], GOAL)
    )
    for push in pushes:
        low, high = way.get_xlim()
        assert low < push.xy[:, 0].min() and push.xy[:, 0].max() < high
    assert to_png(figure).startswith(b"\x89PNG")


@pytest.mark.parametrize("shape", [TIPS, PLATE], ids=["fingertips", "plate"])
def test_a_pusher_is_drawn_as_what_it_is_where_it_is_and_turned(shape):
    push = Push.about((0.0, 0.1), 0.5, shape=shape, start=(-0.08, 0.0), yaw=0.2, duration=1.0)
    figure = draw_motion(make_block(), push, np.zeros((3, 3)))
    covered = [
        Polygon(patch.get_path().vertices)
        for patch in figure.axes[0].patches
        if to_rgb(patch.get_edgecolor()) == to_rgb(LEARNED_COLOR)
    ]
    ends = [shape.at([*push.xy[i], push.yaw[i]]) for i in (0, -1)]
    together = shapely.union_all(ends)
    assert shapely.union_all(covered).symmetric_difference(together).area < 1e-9 * together.area


def test_pushes_that_were_left_out_are_told_apart():
    obj = make_block()
    log = make_pushes(obj, sample_ground_truth(obj, 1), 3, 1)
    refused = Outlier(log[1].name, (), len(log[1].t_observed) + 1, True)
    result = replace(make_identification(obj), outliers=(refused,), unused_pushes=())
    legend = draw_pushes(result, log).axes[0].get_legend()
    assert [text.get_text() for text in legend.get_texts()] == ["learned from", "left out"]


def test_panels_side_by_side_begin_at_one_height_and_no_legend_covers_them():
    obj = make_block()
    figure = draw(obj, [np.zeros(3), np.array([0.1, -0.2, 1.2])])
    figure.canvas.draw()
    tops = [ax.get_window_extent().y1 for ax in figure.axes]
    assert tops[0] == pytest.approx(tops[1], abs=1.0)
    for ax in figure.axes:
        assert not ax.get_legend().get_window_extent().overlaps(ax.get_window_extent())


def test_an_svg_has_no_empty_bands():
    """A wide drawing in a tall figure is cut to what is drawn."""
    figure, ax = make_chart(4.0, 4.0)
    ax.plot([0, 1], [0, 0])
    ax.set_aspect("equal", adjustable="box")
    ax.set_ylim(-0.05, 0.05)
    root = ElementTree.fromstring(to_svg(figure))
    width, height = (float(root.get(side).removesuffix("pt")) for side in ("width", "height"))
    assert height < 0.4 * width


APART = 10
"""Least distance between two titles side by side, pixels: about a letter's width."""


def find_extents(figure, artists):
    """Finds the boxes of some artists of a figure, in pixels."""
    figure.canvas.draw()
    renderer = figure.canvas.get_renderer()
    return [artist.get_window_extent(renderer) for artist in artists]


@pytest.mark.parametrize("name", ["snack_bag", "spray_bottle", "toolbox"])
def test_titles_of_three_columns_keep_apart(name):
    obj = GridObject.from_yaml(find_shipped_object(name))
    found = make_identification(obj)
    for figure in (draw_model(found, CellParameters.uniform(obj)), draw_unknown_maps(found)):
        titled = [ax.title for ax in figure.axes if ax.get_title()]
        extents = find_extents(figure, titled)
        assert all(box.x0 >= 0 and box.x1 <= figure.bbox.x1 for box in extents)
        for i, box in enumerate(extents):
            wide = box.padded(APART / 2)
            assert not any(wide.overlaps(other.padded(APART / 2)) for other in extents[i + 1 :])


def test_the_label_of_an_axis_is_no_longer_than_the_axis():
    """The names of the pushes take room from the axis."""
    names = tuple(f"push_{i}" for i in range(1, 15))
    errors = np.linspace(0.02, 0.001, len(names))
    steps = np.arange(4)
    figure = draw_progress(
        Progress(steps, 0.01 / (1 + steps), np.empty(0), names, errors, 2 * errors)
    )
    for ax in figure.axes:
        axis, label = find_extents(figure, [ax.patch, ax.yaxis.label])
        assert label.y0 >= axis.y0 and label.y1 <= axis.y1, ax.get_ylabel()


def draw_three_objects(count=2):
    """Three blocks that are pushed, all with the same room about them after every push."""
    obj = make_block()
    poses = np.zeros((count + 1, 3, 3))
    poses[:, :, 1] = [0.0, 0.2, 0.4]
    poses[:, :, 0] = 0.1 * np.arange(count + 1)[:, None]
    pushes = [Push([0.1 * i, -0.03], [0.05, 0.0], 1.0, 0.004) for i in range(count)]
    values = np.tile(np.linspace(0.02, 0.06, count + 1)[:, None], (1, 3))
    return draw_scene_run([obj] * 3, ("a", "b", "c"), poses, pushes, values, ("room", 0.05))


def test_lines_that_lie_on_each_other_are_all_seen():
    figure = draw_three_objects()
    chart = figure.axes[1]
    (box,) = find_extents(figure, [chart.patch])
    picture = np.asarray(figure.canvas.buffer_rgba())[::-1, :, :3] / 255
    inside = picture[int(box.y0) : int(box.y1), int(box.x0) : int(box.x1)].reshape(-1, 3)
    lines = [line for line in chart.lines if line.get_linestyle() == "-"]
    assert len(lines) == 3
    for line in lines:
        near = np.abs(inside - to_rgb(line.get_color())).max(axis=1) < 0.02
        assert near.sum() > 200, line.get_color()


def test_the_pushes_of_several_objects_have_their_numbers():
    texts = [text.get_text() for text in draw_three_objects(count=3).axes[0].texts]
    assert [text for text in texts if text] == ["1", "2", "3"]
