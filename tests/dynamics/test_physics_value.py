"""`Physics`: its words, the regime that "auto" stands for, and that one default holds everywhere."""

import inspect
from dataclasses import fields, replace

import pytest

from gridpush_drake.dynamics.kernels.friction.isotropic_friction import ISOTROPIC_LAW
from gridpush_drake.dynamics.kernels.friction.lagged_friction import LAGGED_LAW
from gridpush_drake.dynamics.kernels.friction.laws import FRICTION_LAWS, register_friction_law
from gridpush_drake.dynamics.physics import FAST_PUSH, QUASI_STATIC, Physics, make_physics
from gridpush_drake.dynamics.push import ForcePush, Push
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import IdentificationError, SimulationError
from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.model_file import read_model, write_model
from gridpush_drake.identification.prediction import predict
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.contact.trial import ContactOptions
from gridpush_drake.systems import GridIdentifier, GridLcpSystem
from tests.helpers.made_identifications import make_identification
from tests.helpers.made_logs import make_pushed_block
from tests.helpers.shapes import make_shape

UNUSUAL = Physics("lagged", "inertial", "separate", 1.62, 1e-8, 1e-6)
"""Every field differs from its default."""


def push_at(speed):
    return Push((-0.07, 0.01), (speed, 0.0), 0.02 / speed, 0.01)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (
            {"friction_law": "dry"},
            "friction_law is 'dry'; expected one of 'isotropic', 'lagged', or",
        ),
        ({"regime": "fast"}, "regime is 'fast'; expected one of 'auto', 'inertial'"),
        ({"spin": "both"}, "spin is 'both'"),
        ({"gravity": -1.0}, "gravity is -1.0"),
        ({"stiction_tolerance": 0.0}, "stiction_tolerance is 0.0"),
        ({"relative_stiction_tolerance": float("nan")}, "relative_stiction_tolerance is nan"),
        ({"friction_law": "lagged", "regime": "quasi_static"}, "'lagged' needs the regime"),
    ],
)
def test_what_is_out_of_range_is_refused(values, message):
    with pytest.raises(SimulationError, match=message):
        Physics(**values)


def test_auto_is_resolved_by_speed_friction_and_law():
    obj = make_shape("square", 36)
    limit = (FAST_PUSH * 0.4 * 9.81 * obj.radius_of_gyration) ** 0.5
    physics = Physics(spin="none")
    assert physics.resolve(obj, 0.4, 0.99 * limit) == replace(physics, regime="quasi_static")
    assert physics.resolve(obj, 0.4, 1.01 * limit) == replace(physics, regime="inertial")
    assert physics.resolve(obj, 0.0, 0.0).regime == "inertial", "without friction nothing stops"
    assert QUASI_STATIC.resolve(obj, 0.4, 9.0) is QUASI_STATIC
    assert Physics("lagged").resolve(obj, 0.4, 1e-4).regime == "inertial"
    with pytest.raises(SimulationError, match="resolve"):
        _ = physics.inertial


def test_a_simulation_says_which_regime_it_took():
    obj = make_shape("square", 36)
    params = CellParameters.uniform(obj)
    force = ForcePush((0.0, 0.0), (9.0, 0.0), 0.02)
    assert simulate(Model(obj, params), push_at(0.01)).physics == QUASI_STATIC
    assert simulate(Model(obj, params), push_at(1.0)).physics == Physics(regime="inertial")
    assert simulate(Model(obj, params), push_at(0.01), velocity=(0.1, 0, 0)).physics.inertial
    assert simulate(Model(obj, params), push_at(0.01), gradients="paper").physics.inertial
    assert simulate(Model(obj, params), force).physics.inertial
    assert simulate(Model(obj, params, UNUSUAL), push_at(0.01)).physics is UNUSUAL


def test_a_regime_beside_physics_takes_its_place():
    assert make_physics(None, None) == Physics()
    assert make_physics(QUASI_STATIC, None) is QUASI_STATIC
    assert make_physics(QUASI_STATIC, "inertial").regime == "inertial"


@pytest.mark.parametrize("function", [simulate, predict, identify, GridLcpSystem])
def test_physics_is_the_model_s_everywhere(function):
    parameters = inspect.signature(function).parameters
    assert "physics" not in parameters and parameters["regime"].default is None


def test_one_default_everywhere():
    parameters = inspect.signature(GridIdentifier).parameters
    assert parameters["physics"].default is None and parameters["regime"].default is None
    assert ContactOptions().physics is None and Physics().regime == "auto"


def test_a_model_file_keeps_the_physics(tmp_path):
    model = replace(make_identification(), physics=UNUSUAL)
    write_model(tmp_path / "model.yaml", model)
    assert read_model(tmp_path / "model.yaml").physics == UNUSUAL
    text = (tmp_path / "model.yaml").read_text()
    assert all(f"  {field.name}: " in text for field in fields(Physics))
    (tmp_path / "model.yaml").write_text(text.replace("friction_law: lagged", "friction_law: dry"))
    with pytest.raises(IdentificationError, match=r"model\.yaml: friction_law is 'dry'; expected"):
        read_model(tmp_path / "model.yaml")


def test_a_model_file_of_an_earlier_release_is_read(tmp_path):
    write_model(tmp_path / "model.yaml", make_identification())
    text = (tmp_path / "model.yaml").read_text()
    assert text.count("physics:\n  regime: quasi_static\n") == 1
    old = text.replace("physics:\n  regime: quasi_static\n", "regime: quasi_static\n")
    (tmp_path / "old.yaml").write_text(old)
    assert read_model(tmp_path / "old.yaml").physics == QUASI_STATIC


def test_the_default_method_refuses_a_law_without_gradients():
    made = make_pushed_block()
    with pytest.raises(IdentificationError, match="'lagged' has no exact gradients"):
        identify(Model(made.obj, physics=Physics(friction_law="lagged")), made.log)
    found = identify(
        Model(made.obj, physics=Physics("lagged")), made.log, method="random_search", budget=6
    )
    assert found.physics == Physics("lagged", "inertial")


def test_a_law_is_registered_once_and_by_a_name_of_its_own():
    before = dict(FRICTION_LAWS)
    register_friction_law(ISOTROPIC_LAW)
    assert before == FRICTION_LAWS
    with pytest.raises(SimulationError, match="the name is taken by the law of Isotropic"):
        register_friction_law(replace(LAGGED_LAW, name="isotropic"))
    with pytest.raises(SimulationError, match="its data class Lagged is that of 'lagged'"):
        register_friction_law(replace(LAGGED_LAW, name="late"))
    assert before == FRICTION_LAWS
