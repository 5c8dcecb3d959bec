import dataclasses

import numpy as np
import pytest

from gridpush_drake.errors import ObjectError, ParameterError
from gridpush_drake.objects.grid_object import GridObject, PhysicalPrior
from gridpush_drake.objects.parameters import CellParameters

SQUARE = [[0, 0], [0.2, 0], [0.2, 0.1], [0, 0.1]]
RIGHT_HALF = [[0.1, 0], [0.2, 0], [0.2, 0.1], [0.1, 0.1]]


def bar(**prior):
    return GridObject.from_outline(
        SQUARE, parts={2: RIGHT_HALF}, max_cells=50, prior=PhysicalPrior(**prior)
    )


def test_uniform_takes_what_is_not_given_from_the_prior():
    obj = bar(total_mass=3.0, friction=0.2, contact_friction=0.7)
    params = CellParameters.uniform(obj)
    assert params.total_mass == pytest.approx(3.0)
    assert (params.n, params.contact_friction) == (50, 0.7)
    np.testing.assert_array_equal(params.friction, 0.2)
    given = CellParameters.uniform(obj, 1.0, 0.5, 0.0)
    assert given.total_mass == pytest.approx(1.0)
    assert given.friction[0] == 0.5 and given.contact_friction == 0.0


def test_mass_properties_of_a_uniform_rectangle():
    obj, mass = bar(), 2.0
    params = CellParameters.uniform(obj, mass)
    np.testing.assert_allclose(params.center_of_mass(obj), [0.1, 0.05], atol=1e-12)
    assert params.inertia(obj) == pytest.approx(mass * (0.2**2 + 0.1**2) / 12)
    assert params.inertia(obj) == pytest.approx(mass * obj.radius_of_gyration**2)


def test_mass_properties_by_part():
    obj = bar()
    params = CellParameters.by_part(obj, {1: 0.01, 2: 0.03, 9: 1.0}, friction={1: 0.4, 2: 0.2})
    assert params.total_mass == pytest.approx(25 * 0.04)
    np.testing.assert_allclose(
        params.center_of_mass(obj), [0.05 * 0.25 + 0.15 * 0.75, 0.05], atol=1e-12
    )
    parallel_axes = 0.25 * 0.75 * 0.1**2
    assert params.inertia(obj) == pytest.approx((0.1**2 + 0.1**2) / 12 + parallel_axes)
    np.testing.assert_allclose(params.relative_friction()[obj.labels == 2].sum(), 0.6)
    assert params.relative_friction().sum() == pytest.approx(1)


def test_missing_part_is_named():
    with pytest.raises(ParameterError, match="no value for part 2"):
        CellParameters.by_part(bar(), {1: 0.1})
    with pytest.raises(ParameterError, match="friction: no value for part 1"):
        CellParameters.by_part(bar(), {1: 0.1, 2: 0.1}, friction={2: 0.1})


def test_random_draws_are_seeded_and_in_range():
    obj = bar()
    one = CellParameters.random(obj, 7, (0.1, 5.0), (0.2, 0.6))
    other = CellParameters.random(obj, 7, (0.1, 5.0), (0.2, 0.6))
    np.testing.assert_array_equal(one.mass, other.mass)
    assert len(np.unique(one.mass)) == len(np.unique(one.friction)) == 2
    cells = CellParameters.random(obj, 7, (0.1, 5.0), by="cell")
    assert len(np.unique(cells.mass)) == 50
    assert (cells.mass >= 0.1).all() and (cells.mass <= 5.0).all()
    np.testing.assert_array_equal(cells.friction, obj.prior.friction)


@pytest.mark.parametrize(
    "options",
    [
        {"mass_range": (0, 1)},
        {"mass_range": (2, 1)},
        {"mass_range": (1, np.inf)},
        {"mass_range": (np.nan, 1)},
        {"friction_range": (-0.1, 0.5)},
        {"friction_range": (0.5, 0.1)},
        {"by": "pixel"},
    ],
)
def test_random_refuses_bad_ranges(options):
    with pytest.raises(ParameterError):
        CellParameters.random(bar(), 0, **options)


@pytest.mark.parametrize(
    "mass, friction, contact",
    [
        ([1.0, 0.0], [0.1, 0.1], 0.5),
        ([1.0, np.nan], [0.1, 0.1], 0.5),
        ([1.0, 1.0], [0.1, -0.1], 0.5),
        ([1.0, 1.0], [0.1, np.inf], 0.5),
        ([1.0, 1.0], [0.1], 0.5),
        ([], [], 0.5),
        ([[1.0]], [[0.1]], 0.5),
        ([1.0], [0.1], -0.1),
        ([1.0], [0.1], np.nan),
    ],
)
def test_values_out_of_range_are_refused(mass, friction, contact):
    with pytest.raises(ParameterError):
        CellParameters(mass, friction, contact)


@pytest.mark.parametrize("patch", [-0.1, 1.1, np.nan, np.inf])
def test_patch_is_a_part_of_the_cell(patch):
    with pytest.raises(ParameterError, match="patch_ratio is"):
        CellParameters([1.0], [0.1], patch_ratio=patch)


def test_parameters_are_frozen_copies():
    mass = np.ones(3)
    params = CellParameters(mass, np.full(3, 0.1))
    mass[0] = 9
    assert params.mass[0] == 1
    with pytest.raises(ValueError, match="read-only"):
        params.mass[0] = 2
    with pytest.raises(dataclasses.FrozenInstanceError):
        params.contact_friction = 0.1


def test_parameters_of_another_object_are_refused():
    with pytest.raises(ParameterError, match="expected 50"):
        CellParameters(np.ones(3), np.ones(3)).inertia(bar())


def test_relative_friction_without_friction_is_even():
    np.testing.assert_array_equal(CellParameters([1.0, 3.0], [0.0, 0.0]).relative_friction(), 0.5)


@pytest.mark.parametrize(
    "values",
    [
        {"total_mass": 0},
        {"total_mass": np.nan},
        {"center_of_mass": (0.0, np.nan)},
        {"center_of_mass": (0.0, 0.0, 0.0)},
        {"center_of_mass": 0.1},
        {"center_of_mass_std": 0},
        {"friction": 1.5},
        {"friction_min": 0},
        {"friction_min": 0.6},
        {"friction_max": np.inf},
        {"contact_friction": -0.1},
        {"contact_friction_std": -1},
        {"pusher_radius": 0},
    ],
)
def test_prior_refuses_values_out_of_range(values):
    with pytest.raises(ParameterError):
        PhysicalPrior(**values)


def test_object_refuses_what_does_not_fit_together():
    obj = bar()
    good = {
        "name": "a",
        "p_BC": obj.p_BC,
        "cell_size": 0.02,
        "labels": obj.labels,
        "outline": obj.outline,
    }
    GridObject(**good)
    for bad in (
        {"labels": obj.labels[1:]},
        {"labels": 0 * obj.labels},
        {"p_BC": obj.p_BC * np.nan},
        {"p_BC": np.empty((0, 2)), "labels": []},
        {"cell_size": 0},
        {"cell_size": np.nan},
        {"outline": obj.outline.exterior},
    ):
        with pytest.raises(ObjectError):
            GridObject(**(good | bad))


def test_cells_at_poses():
    obj = bar()
    placed = obj.cells_at([[0.0, 0.0, 0.0], [1.0, 2.0, np.pi / 2]])
    np.testing.assert_allclose(placed[0], obj.p_BC)
    np.testing.assert_allclose(placed[1], np.column_stack([1 - obj.p_BC[:, 1], 2 + obj.p_BC[:, 0]]))
    assert obj.cells_at(np.zeros((4, 5, 3))).shape == (4, 5, 50, 2)
