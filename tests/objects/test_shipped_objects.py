import numpy as np
import pytest
import shapely

from gridpush_drake.errors import ObjectError
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import find_shipped_object, list_shipped_objects

NAMES = [
    "claw_hammer",
    "combination_wrench",
    "open_book",
    "pliers",
    "snack_bag",
    "spray_bottle",
    "spring_clamp",
    "toolbox",
    "toothpaste_tube",
]


def fine_points(outline, count=400):
    """Points of a fine lattice inside the outline."""
    low_x, low_y, high_x, high_y = outline.bounds
    grid = np.meshgrid(np.linspace(low_x, high_x, count), np.linspace(low_y, high_y, count))
    points = np.column_stack([axis.ravel() for axis in grid])
    return points[shapely.contains_xy(outline, *points.T)]


def test_all_are_listed():
    assert list_shipped_objects() == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_object_is_read_and_its_cells_are_true_to_its_outline(name):
    obj = GridObject.from_yaml(find_shipped_object(name))
    points = fine_points(obj.outline)
    center = points.mean(axis=0)
    spread = np.sqrt(((points - center) ** 2).sum(axis=1).mean())
    assert obj.name == name
    assert 115 <= obj.n <= 127
    assert np.linalg.norm(obj.p_BC.mean(axis=0) - center) < 0.03 * spread
    assert obj.radius_of_gyration == pytest.approx(spread, rel=0.02)
    assert obj.n * obj.cell_size**2 == pytest.approx(obj.outline.area, rel=0.05)


@pytest.mark.parametrize("name", NAMES)
def test_object_says_what_is_known_of_it(name):
    obj = GridObject.from_yaml(find_shipped_object(name))
    assert 2 <= len(set(obj.labels)) <= 3
    assert min(np.bincount(obj.labels)[1:]) >= 5
    assert 0.05 < obj.prior.total_mass < 5
    assert obj.prior.pusher_radius == 0.01
    assert 20 <= len(obj.outline.exterior.coords) <= 70
    assert 0.15 < np.ptp(obj.p_BC, axis=0).max() < 0.5


def test_wrench_clamp_and_toolbox_have_a_hole():
    holes = {
        name: len(GridObject.from_yaml(find_shipped_object(name)).outline.interiors)
        for name in NAMES
    }
    assert [name for name, count in holes.items() if count] == [
        "combination_wrench",
        "spring_clamp",
        "toolbox",
    ]


def test_unknown_name_is_answered_with_the_nearest_and_all():
    with pytest.raises(ObjectError, match="did you mean claw_hammer") as caught:
        find_shipped_object("claw_hamer")
    assert all(name in str(caught.value) for name in NAMES)
    with pytest.raises(ObjectError, match="no shipped object"):
        find_shipped_object("../scenes/x")
