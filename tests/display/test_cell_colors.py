import numpy as np
import pytest
from matplotlib import colormaps

from gridpush_drake.display.cell_colors import CellColors
from gridpush_drake.errors import StationError

EVEN = np.full(8, 0.4)


def viridis(u):
    return colormaps["viridis"](float(u))[:3]


@pytest.mark.parametrize("shows", ["mass", "relative_friction"])
@pytest.mark.parametrize("total", [0.2, 7.0])
def test_an_even_object_has_the_middle_color_whatever_it_weighs(shows, total):
    colors = CellColors(shows).calc_colors(np.full(8, total / 8), EVEN)
    np.testing.assert_allclose(colors, np.tile(viridis(0.5), (8, 1)))


def test_shares_follow_their_logarithm_and_are_cut_at_the_limits():
    values = [0.01, 0.25, 0.5, 1.0, 2.0, 4.0, 100.0]
    expected = [viridis(u) for u in (0, 0, 0.25, 0.5, 0.75, 1.0, 1.0)]
    np.testing.assert_allclose(CellColors().calc_colors_of(values), expected)


def test_mass_and_relative_friction_are_told_apart():
    mass, friction = np.array([1.0, 2.0]), np.array([0.4, 0.1])
    np.testing.assert_allclose(CellColors("mass").calc_values(mass, friction), [2 / 3, 4 / 3])
    np.testing.assert_allclose(
        CellColors("relative_friction").calc_values(mass, friction), [4 / 3, 2 / 3]
    )
    np.testing.assert_allclose(CellColors("friction").calc_values(mass, friction), friction)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"shows": "weight"}, "shows is 'weight'.*mass, friction, relative_friction"),
        ({"limits": (0.0, 1.0)}, "limits.*0 < least < greatest"),
        ({"limits": (2.0, 1.0)}, "limits.*0 < least < greatest"),
        ({"colormap": "jete"}, "colormap is 'jete'"),
    ],
)
def test_refuses(arguments, says):
    with pytest.raises(StationError, match=says):
        CellColors(**arguments)
