"""`Bodies` and `Model`: what one holds of objects, in one value."""

import numpy as np
import pytest

from gridpush_drake.dynamics.bodies import Bodies
from gridpush_drake.dynamics.physics import QUASI_STATIC, Physics
from gridpush_drake.errors import IdentificationError, SimulationError
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.parameters import CellParameters
from tests.helpers.shapes import make_shape


def test_one_object_needs_no_index_and_several_refuse_the_short_form():
    square, bracket = make_shape("square", 9), make_shape("l_bracket", 30)
    one = Model(square)
    assert one.obj is square and one.objects == (square,) and len(one) == 1
    assert one.params.total_mass == CellParameters.uniform(square).total_mass
    np.testing.assert_array_equal(one.center_of_mass, one.params.center_of_mass(square))
    both = Bodies([square, bracket])
    assert both.center_of_mass.shape == (2, 2)
    with pytest.raises(SimulationError, match=r"obj: there are 2 objects \(.*\); expected one"):
        _ = both.obj


def test_wrong_or_swapped_arguments_are_named():
    square, bracket = make_shape("square", 9), make_shape("l_bracket", 30)
    params = CellParameters.uniform(square)
    with pytest.raises(TypeError, match="objects is a CellParameters; expected a GridObject"):
        Model(params, square)
    with pytest.raises(SimulationError, match=f"parameters of 9 cells; expected {bracket.n}"):
        Model(bracket, params)
    with pytest.raises(SimulationError, match="parameters of 1 objects; expected 2"):
        Model([square, bracket], params)
    with pytest.raises(SimulationError, match="objects: there is none"):
        Model([])


def test_a_changed_model_is_another_one():
    model = Model(make_shape("square", 9))
    heavy = model.with_params(CellParameters.uniform(model.obj, total_mass=3.0))
    assert isinstance(heavy, Model) and heavy.total_mass == pytest.approx(3.0)
    assert model.with_physics(QUASI_STATIC).physics is QUASI_STATIC
    assert model.physics == Physics() and model.total_mass != heavy.total_mass
    # The regime "auto" becomes that of the speed; another one stays.
    assert model.resolve(1e-3).physics.regime == "quasi_static"
    assert model.resolve(5.0).physics.regime == "inertial"
    assert model.resolve(5.0, "quasi_static").physics.regime == "quasi_static"


def test_a_model_that_was_not_learned_draws_itself():
    model = Model(make_shape("square", 9))
    assert model.draws(3) == [model.params] * 3
    with pytest.raises(IdentificationError, match="draws: count is -1"):
        model.draws(-1)
