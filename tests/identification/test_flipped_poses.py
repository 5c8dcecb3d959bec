"""A tracker that takes one end of a symmetric outline for the other is found out; a good one is not."""

from dataclasses import replace

import numpy as np
import pytest
from shapely import affinity

from gridpush_drake.dynamics.physics import Physics
from gridpush_drake.errors import PushLogWarning
from gridpush_drake.identification.fit.flipped_poses import find_symmetry, turn_poses
from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from tests.helpers.shapes import make_shape
from tests.identification.simulated_pokes import make_pokes

PLATE = np.array([[-0.07, -0.04], [0.07, -0.04], [0.07, 0.04], [-0.07, 0.04]])
NOISE = (5e-4, 3.5e-3)


def make_plate(corners=PLATE, heavier: float = 0.0):
    """A plate whose one end weighs more, by the factor's logarithm."""
    obj = GridObject.from_outline(corners, max_cells=24, name="plate")
    x = obj.p_BC[:, 0] - obj.p_BC[:, 0].mean()
    even = CellParameters.uniform(obj, 1.0, 0.4, 0.3)
    weight = np.exp(heavier * x / x.max())
    return obj, replace(even, mass=even.mass * weight / weight.mean())


@pytest.mark.parametrize(
    ("corners", "order"),
    [
        (PLATE, 2),
        (PLATE + [0.03, -0.02], 2),
        ([[0, 0], [1, 0], [1, 1], [0, 1]], 4),
        ([[np.cos(a), np.sin(a)] for a in np.arange(6) * np.pi / 3], 6),
        ([[0, 0], [1, 0], [0, 1]], 1),
    ],
)
def test_symmetries(corners, order):
    obj = GridObject.from_outline(0.1 * np.array(corners, dtype=float), max_cells=10)
    assert find_symmetry(obj) == order


def test_bracket_has_no_symmetry():
    assert find_symmetry(make_shape("l_bracket", 20)) == 1


def test_turned_poses_leave_the_outline_where_it_is():
    obj, truth = make_plate(PLATE + [0.03, -0.02])
    log = make_pokes(obj, truth, 2, 1)
    turned = turn_poses(obj, log, np.array([0, 1]), 2)
    np.testing.assert_array_equal(turned[0].pose, log[0].pose)
    for one, other in zip(log[1].poses_observed, turned[1].poses_observed, strict=True):
        assert other[2] - one[2] == pytest.approx(np.pi)
        places = [
            affinity.affine_transform(
                obj.outline, [np.cos(q[2]), -np.sin(q[2]), np.sin(q[2]), np.cos(q[2]), q[0], q[1]]
            )
            for q in (one, other)
        ]
        assert places[0].symmetric_difference(places[1]).area < 1e-9


@pytest.mark.parametrize(
    ("corners", "seed"), [(PLATE, 5), (PLATE + [0.03, -0.02], 4)], ids=["centered", "aside"]
)
def test_half_turned_poses_are_named(corners, seed):
    obj, truth = make_plate(corners, heavier=1.2)
    log = make_pokes(obj, truth, 8, seed, noise=NOISE)
    identify(Model(obj), log)  # warnings are errors: without a word
    off = np.array([0, 1, 0, 1, 0, 1, 1, 0])
    with pytest.warns(PushLogWarning, match=r"object_theta: .* half a turn off") as caught:
        identify(Model(obj), turn_poses(obj, log, off, 2))
    named = str(caught[0].message).split("pushes (")[1].split(")")[0].split(", ")
    # which half is the turned one, nobody can know
    halves = [{log[i].name for i in np.flatnonzero(off == side)} for side in (0, 1)]
    assert len(named) >= 3
    assert any(half.issuperset(named) for half in halves)


def test_few_half_turned_poses_are_left_out_and_the_center_is_right():
    obj, truth = make_plate(heavier=1.2)
    log = make_pokes(obj, truth, 8, 0, noise=NOISE)
    found = identify(Model(obj), turn_poses(obj, log, np.array([0, 1, 0, 1, 0, 0, 0, 0]), 2))
    assert [(one.push, one.whole) for one in found.outliers] == [("poke_1", True), ("poke_3", True)]
    center, true_center = (
        params.mass @ obj.p_BC / params.mass.sum() for params in (found.params, truth)
    )
    assert np.linalg.norm(center - true_center) < 0.003


def test_a_search_with_a_law_without_gradients_is_not_asked_for_them():
    obj, truth = make_plate()
    log = make_pokes(obj, truth, 4, 1, noise=NOISE)
    found = identify(Model(obj, physics=Physics("lagged")), log, method="random_search", budget=8)
    assert found.physics.friction_law == "lagged"


@pytest.mark.parametrize("heavier", [0.0, 0.4, 1.2])
def test_good_poses_of_symmetric_plates_are_taken_without_a_word(heavier):
    for corners in (PLATE, 0.1 * np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])):
        obj, truth = make_plate(corners, heavier)
        identify(Model(obj), make_pokes(obj, truth, 6, 3, noise=NOISE))
