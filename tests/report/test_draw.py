import subprocess
import sys

import numpy as np
import pytest
from shapely import Polygon

from gridpush_drake.errors import ObjectError
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.report.draw import draw_cells, draw_outline, draw_parts, make_grid, to_png

RIGHT_HALF = [[0.1, 0], [0.2, 0], [0.2, 0.1], [0.1, 0.1]]


def make_axes():
    figure, axes = make_grid(1, 1, 6.0, 4.5)
    return figure, axes[0, 0]


def bar():
    return GridObject.from_outline([[0, 0], [0.2, 0], [0.2, 0.1], [0, 0.1]], parts={4: RIGHT_HALF}, max_cells=50)


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
    assert (low < obj.cells_at(pose).min(axis=0)).all() and (high > obj.cells_at(pose).max(axis=0)).all()


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


def test_wrong_number_of_values_is_refused():
    _, ax = make_axes()
    with pytest.raises(ObjectError, match="one for each cell"):
        draw_cells(ax, bar(), np.ones(3))


def test_drawing_leaves_pyplot_alone():
    code = "import sys, gridpush_drake.report.draw; assert 'matplotlib.pyplot' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
