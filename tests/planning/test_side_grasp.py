"""Grasps from beyond the rim: the pads on the object, the gripper clear of the table and of the object."""

import time
from dataclasses import fields, replace

import numpy as np
import pytest
import shapely
from shapely.affinity import affine_transform

from gridpush_drake.errors import PlanningError
from gridpush_drake.grid.object_file import find_shipped_object, read_object
from gridpush_drake.planning.side_grasp import SideGripper, find_side_grasps
from gridpush_drake.planning.surface import SupportSurface
from tests.helpers.made_identifications import make_block

TABLE = SupportSurface.rectangle([0.6, -0.45], [0.8, 1.2])  # its rim y = 0.15 m faces the gripper
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
    obj, g = read_object(find_shipped_object(name)), SideGripper()
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
        np.testing.assert_allclose(np.array([[c, -s], [s, c]]) @ grasp.p_BG + pose[:2], grasp.p_WG, atol=1e-12)


def test_nearest_to_the_aim_comes_first():
    obj, pose = read_object(find_shipped_object("claw_hammer")), (0.5, 0.08, np.pi / 2)
    for aim in ([0.1, 0.0], [0.14, 0.04]):
        found = find_side_grasps(obj, pose, TABLE, aim=aim)
        distances = [grasp.distance for grasp in found]
        assert distances == pytest.approx([np.linalg.norm(grasp.p_BG - aim) for grasp in found])
        assert (np.diff(distances) > -1e-5).all()


def test_finds_none_where_too_little_hangs_over():
    obj = read_object(find_shipped_object("claw_hammer"))
    assert not find_side_grasps(obj, (0.5, -0.1, 0.0), TABLE)
    assert not find_side_grasps(obj, (0.5, 0.005, np.pi / 2), TABLE)  # 2 cm
    assert find_side_grasps(obj, (0.5, 0.035, np.pi / 2), TABLE)  # 5 cm


def test_finds_none_where_the_pads_are_wider_than_what_hangs_over():
    obj, pose = make_block(), (0.5, 0.17, 0.0)
    assert find_side_grasps(obj, pose, TABLE, SideGripper(pad_width=0.01, pad_length=0.01))
    assert not find_side_grasps(obj, pose, TABLE, SideGripper(pad_width=0.3, pad_length=0.01))


@pytest.mark.parametrize("name", [field.name for field in fields(SideGripper)])
@pytest.mark.parametrize("value", [-0.01, np.nan])
def test_bad_measures_are_refused(name, value):
    with pytest.raises(PlanningError, match=f"side gripper: {name} is"):
        replace(SideGripper(), **{name: value})


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


def test_it_takes_little_time():
    obj = read_object(find_shipped_object("spray_bottle"))
    best = np.inf
    for _ in range(5):
        start = time.process_time()
        find_side_grasps(obj, OVERHANGING[2][1], TABLE)
        best = min(best, time.process_time() - start)
    assert best < 0.25  # 0.05 on an idle machine
