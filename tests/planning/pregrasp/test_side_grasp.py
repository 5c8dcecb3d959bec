"""Grasps from beyond the edge: the pads on the object, the gripper clear of the table and of the object."""

import re
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
import shapely
from shapely.affinity import affine_transform

from gridpush_drake.errors import PlanningError
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import find_shipped_object
from gridpush_drake.planning.pregrasp.grasp.gripper import Gripper
from gridpush_drake.planning.pregrasp.grasp.side_grasp import choose_varied, find_side_grasps
from gridpush_drake.planning.support_surface import SupportSurface
from tests.helpers.made_identifications import make_block

TABLE = SupportSurface.rectangle([0.6, -0.45], [0.8, 1.2])  # its edge y = 0.15 m faces the gripper
OVERHANGING = [
    ("claw_hammer", (0.5, 0.08, np.pi / 2)),
    ("combination_wrench", (0.5, 0.138, np.pi / 3)),
    ("spray_bottle", (0.5, 0.09, 3.14)),
]


def place(outline, pose):
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return affine_transform(outline, [c, -s, s, c, pose[0], pose[1]])


def lane(grasp, back, front, width):
    """The rectangle from `back` to `front` along the heading, seen from the grasp point."""
    u = np.array([np.cos(grasp.approach), np.sin(grasp.approach)])
    v = width / 2 * np.array([-u[1], u[0]])
    far, near = grasp.p_WG + back * u, grasp.p_WG + front * u
    return shapely.Polygon([far - v, near - v, near + v, far + v])


@pytest.mark.parametrize(("name", "pose"), OVERHANGING)
def test_pads_are_on_the_object_and_the_gripper_is_clear(name, pose):
    obj, g = GridObject.from_yaml(find_shipped_object(name)), Gripper()
    found = find_side_grasps(obj, pose, TABLE)
    outline = place(obj.outline, pose)
    assert found
    for grasp in found[:: max(len(found) // 20, 1)]:
        half = g.pad_length / 2
        assert outline.contains(lane(grasp, -half, half, g.pad_width))
        jaw = lane(grasp, -g.body_front - g.standoff, g.jaw_reach, g.jaw_width)
        assert jaw.distance(TABLE.polygon) >= g.table_clearance - 1e-4
        assert grasp.clearance == pytest.approx(jaw.distance(TABLE.polygon))
        rest = lane(grasp, -g.body_back - g.standoff, -g.body_front, g.body_width)
        assert rest.distance(TABLE.polygon) >= g.table_clearance - 1e-4
        assert rest.distance(outline) >= g.object_clearance - 1e-4
        above = lane(grasp, -g.body_front - g.standoff, g.jaw_reach - g.standoff, g.jaw_width)
        assert above.distance(outline) >= g.object_clearance - 1e-4
        assert np.sin(grasp.approach) < -0.25  # inwards
        c, s = np.cos(pose[2]), np.sin(pose[2])
        np.testing.assert_allclose(
            np.array([[c, -s], [s, c]]) @ grasp.p_BG + pose[:2], grasp.p_WG, atol=1e-12
        )


def lanes(points, heading, back, front, width):
    """As `lane`, for points (k, 2) of one heading."""
    c, s = np.cos(heading), np.sin(heading)
    corners = np.array([(back, -width), (front, -width), (front, width), (back, width)]) * [
        1.0,
        0.5,
    ]
    return shapely.polygons(points[:, None] + corners @ np.array([[c, s], [-s, c]]))


def search_finely(outline, surface, aim, pitch, turn, phase):
    """Distance from `aim` of the nearest place on a fine grid of points, m, and headings, degrees; NaN without one."""
    g = Gripper()
    inner, table = outline.buffer(-g.pad_margin), surface.polygon.buffer(g.table_clearance)
    grown, core = (
        outline.buffer(g.object_clearance),
        outline.buffer(-g.pad_margin - g.pad_width / 2 + 1e-6),
    )
    for shape in (inner, table, grown):
        shapely.prepare(shape)
    core -= table
    left, low, right, high = core.bounds
    x, y = (
        np.arange(left + phase[0] * pitch, right, pitch),
        np.arange(low + phase[1] * pitch, high, pitch),
    )
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    points = points[shapely.contains_xy(core, *points.T)]
    best = np.nan
    for heading in np.radians(
        np.arange(-165 + phase[2] * turn, -15, turn)
    ):  # the way in is -90 degrees
        left = points[
            shapely.covers(
                inner, lanes(points, heading, -g.pad_length / 2, g.pad_length / 2, g.pad_width)
            )
        ]
        jaw, body = (g.jaw_reach, g.jaw_width), (-g.body_front, g.body_width)
        for shape, back, (front, width) in (
            (table, -g.body_front - g.standoff, jaw),
            (table, -g.body_back - g.standoff, body),
            (grown, -g.body_back - g.standoff, body),
            (grown, -g.body_front - g.standoff, (g.jaw_reach - g.standoff, g.jaw_width)),
        ):
            left = left[~shapely.intersects(shape, lanes(left, heading, back, front, width))]
        best = np.fmin(best, np.linalg.norm(left - aim, axis=1).min(initial=np.inf))
    return best if np.isfinite(best) else np.nan


def make_bar(width):
    outline = [[-0.12, -width / 2], [0.12, -width / 2], [0.12, width / 2], [-0.12, width / 2]]
    return GridObject.from_outline(outline, max_cells=40, name="bar")


@pytest.mark.parametrize("degrees", [33.3, 61.7, 94.4, 128.9, -147.1])
@pytest.mark.parametrize("width", [0.013, 0.0132])
def test_finds_places_on_a_bar_hardly_wider_than_the_pads(width, degrees):
    obj, heading, g = make_bar(width), np.radians(degrees), Gripper()
    u = np.array([np.cos(heading), np.sin(heading)])
    pose = np.append(np.array([0.5, 0.15]) + 0.02 * u * np.sign(u[1]), heading)
    found = find_side_grasps(obj, pose, TABLE)
    assert found
    slack = np.arcsin((width - 0.013) / g.pad_length) + 1e-4
    assert all(
        abs(np.cross([*u, 0], [np.cos(f.approach), np.sin(f.approach), 0])[2]) < slack
        for f in found
    )
    # the bar's outer end, 140 mm from the edge, is just clear of the gripper's body
    assert found[0].distance == pytest.approx(0.12 - (g.body_front - g.object_clearance), abs=3e-4)


def test_finds_none_on_a_bar_narrower_than_the_pads():
    assert not find_side_grasps(make_bar(0.0129), (0.5, 0.17, 1.234), TABLE)


def test_finds_none_with_a_heading_that_does_not_point_inwards():
    assert find_side_grasps(make_block(), (0.5, 0.17, 0.1), TABLE)
    assert not find_side_grasps(make_block(), (0.5, 0.17, 0.1), TABLE, headings=1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "y", "theta"),
    [
        ("combination_wrench", 0.105, 1.072),
        ("combination_wrench", 0.12, -1.9),
        ("pliers", 0.2, -2.893),
        ("claw_hammer", 0.13, 0.8),
    ],
)
def test_is_about_as_good_as_a_fine_search(name, y, theta):
    obj, pose = GridObject.from_yaml(find_shipped_object(name)), np.array([0.5, y, theta])
    aim = obj.p_BC.mean(axis=0)
    c, s = np.cos(theta), np.sin(theta)
    rng = np.random.default_rng(0)
    best = search_finely(
        place(obj.outline, pose),
        TABLE,
        np.array([[c, -s], [s, c]]) @ aim + pose[:2],
        6e-4,
        1.5,
        rng.uniform(size=3),
    )
    assert np.isfinite(best)
    found = find_side_grasps(obj, pose, TABLE, aim=aim)
    assert found
    assert found[0].distance < best + 0.004


def test_nearest_to_the_aim_comes_first():
    obj, pose = GridObject.from_yaml(find_shipped_object("claw_hammer")), (0.5, 0.08, np.pi / 2)
    for aim in ([0.1, 0.0], [0.14, 0.04]):
        found = find_side_grasps(obj, pose, TABLE, aim=aim)
        distances = [grasp.distance for grasp in found]
        assert distances == pytest.approx([np.linalg.norm(grasp.p_BG - aim) for grasp in found])
        assert (np.diff(distances) > -1e-5).all()


def test_finds_none_where_too_little_hangs_over():
    obj = GridObject.from_yaml(find_shipped_object("claw_hammer"))
    assert not find_side_grasps(obj, (0.5, -0.1, 0.0), TABLE)
    assert not find_side_grasps(obj, (0.5, 0.005, np.pi / 2), TABLE)  # 2 cm
    assert find_side_grasps(obj, (0.5, 0.035, np.pi / 2), TABLE)  # 5 cm


def test_finds_none_where_the_pads_are_wider_than_what_hangs_over():
    obj, pose = make_block(), (0.5, 0.17, 0.0)
    assert find_side_grasps(obj, pose, TABLE, Gripper(pad_width=0.01, pad_length=0.01))
    assert not find_side_grasps(obj, pose, TABLE, Gripper(pad_width=0.3, pad_length=0.01))


@pytest.mark.parametrize("name", [field.name for field in fields(Gripper)])
@pytest.mark.parametrize("value", [-0.01, np.nan])
def test_bad_measures_are_refused(name, value):
    with pytest.raises(PlanningError, match=f"gripper: {name} is"):
        replace(Gripper(), **{name: value})


def test_bad_arguments_are_refused():
    obj, pose = make_block(), (0.5, 0.13, 0.0)
    with pytest.raises(PlanningError, match=r"0\.09 m thick"):
        find_side_grasps(obj, pose, TABLE, height=0.09)
    with pytest.raises(PlanningError, match="pose is"):
        find_side_grasps(obj, (0.5, np.nan, 0.0), TABLE)
    with pytest.raises(PlanningError, match="aim is"):
        find_side_grasps(obj, pose, TABLE, aim=[0.0])
    with pytest.raises(PlanningError, match="step"):
        find_side_grasps(obj, pose, TABLE, step=0.0)


def test_the_gripper_of_the_page_takes_the_hammer():
    page = Path(__file__).parents[3] / "docs" / "extending.md"
    if not page.is_file():
        pytest.skip("a wheel's tests have no docs beside them")
    (example,) = re.findall("```python\n([^`]*limit_pads[^`]*)```", page.read_text())
    names = {}
    exec(example, names)
    assert names["grasps"] and names["pads"].force == 60.0
    assert names["pads"].gripper is names["gripper"]


def test_varied_grasps_are_the_best_of_their_kind():
    name, pose = OVERHANGING[0]
    found = find_side_grasps(GridObject.from_yaml(find_shipped_object(name)), pose, TABLE)
    chosen = choose_varied(found, 10, min_distance=0.01, min_turn=0.2)
    assert len(chosen) == 10 and chosen[0] is found[0]

    def alike(a, b):
        turn = abs((a.approach - b.approach + np.pi) % (2 * np.pi) - np.pi)
        return np.linalg.norm(a.p_WG - b.p_WG) < 0.01 and turn < 0.2

    assert not any(alike(a, b) for i, a in enumerate(chosen) for b in chosen[:i])
    ranks = [next(k for k, grasp in enumerate(found) if grasp is one) for one in chosen]
    assert ranks == sorted(ranks)
    for k in range(ranks[-1]):
        assert any(alike(found[k], one) for one in chosen)
    assert choose_varied([], 3) == []
