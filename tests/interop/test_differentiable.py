"""What the doors to JAX and torch share, without either."""

from math import prod

import numpy as np
import pytest

from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import GridPushError, SimulationError
from gridpush_drake.identification.model import Model
from gridpush_drake.interop.differentiable import ARGUMENT_NAMES, PushFunction, PushSetting
from gridpush_drake.objects.parameters import CellParameters
from tests.helpers.finite_difference import check_jacobian
from tests.interop.push_functions import REGIMES


def test_it_is_what_simulate_does(case):
    function = PushFunction(case.obj, case.make_setting())
    values = case.values
    motion = simulate(
        Model(case.obj, CellParameters(values["mass"], values["friction"], 0.4)),
        Push(values["start"], values["velocity"], 0.5, 0.006),
        values["pose"],
        times=np.linspace(0.0, 0.5, 26),
        regime="quasi_static",
    )
    np.testing.assert_array_equal(function.calc_poses(*values.values()), motion.final_pose)
    whole = PushFunction(case.obj, case.make_setting(path=True))
    np.testing.assert_array_equal(whole.calc_poses(*values.values()), motion.poses)
    assert np.linalg.norm(motion.final_pose - values["pose"]) > 0.01


@pytest.mark.parametrize("regime", REGIMES)
@pytest.mark.parametrize("name", ARGUMENT_NAMES)
def test_every_block_meets_finite_differences(case, name, regime):
    function = PushFunction(case.obj, case.make_setting(regime))
    values = dict(case.values)
    at = ARGUMENT_NAMES.index(name)
    _, blocks = function.differentiate(*values.values())

    def vary(x):
        return function.calc_poses(*(values | {name: x}).values())

    check_jacobian(vary, values[name], blocks[at], step=1e-5, rtol=2e-4, order=4)


def test_leading_dimensions_broadcast(case):
    function = PushFunction(case.obj, case.make_setting(path=True))
    values = dict(case.values)
    values["start"] = values["start"] + np.linspace(0, 0.001, 2)[:, None, None] * np.ones(2)
    values["contact_friction"] = np.linspace(0.3, 0.5, 3)
    poses, blocks = function.differentiate(*values.values())
    assert poses.shape == (2, 3, 26, 3)
    for block, name in zip(blocks, ARGUMENT_NAMES, strict=True):
        assert block.shape == (2, 3, 26, 3, *case.values[name].shape), name
    one = {**values, "start": values["start"][1, 0], "contact_friction": np.array(0.4)}
    alone, of_it = function.differentiate(*one.values())
    np.testing.assert_array_equal(poses[1, 1], alone)
    for block, own in zip(blocks, of_it, strict=True):
        np.testing.assert_array_equal(block[1, 1], own)
    none = {**values, "start": np.empty((0, 1, 2))}
    poses, blocks = function.differentiate(*none.values())
    assert prod(poses.shape) == sum(block.size for block in blocks) == 0


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"duration": 0.0}, "duration is 0.0; expected a positive number"),
        ({"duration": 1.0, "steps": 0}, "steps is 0; expected 1 or more"),
        ({"duration": 1.0, "path": True}, "path: all poses are asked for; expected a number"),
    ],
)
def test_a_setting_that_makes_no_sense_is_refused(settings, message):
    with pytest.raises(SimulationError, match=message):
        PushSetting(**settings)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"velocity": np.zeros(2)}, r"velocity is \(0, 0\) in a push"),
        ({"mass": np.ones(3)}, r"mass has shape \(3,\); expected"),
        ({"pose": np.zeros(2)}, r"pose has shape \(2,\); expected"),
        ({"mass": None}, "mass: expected positive finite"),
        ({"start": np.full(2, np.nan)}, "push: start"),
    ],
)
def test_arguments_that_will_not_do_are_refused(case, changed, message):
    function = PushFunction(case.obj, case.make_setting())
    if changed.get("mass", 0) is None:
        changed = {"mass": -case.values["mass"]}
    with pytest.raises(GridPushError, match=message):
        function.calc_poses(*(case.values | changed).values())


def test_what_is_not_given_is_the_objects_own(case):
    function = PushFunction(case.obj, PushSetting(duration=0.5))
    with pytest.raises(SimulationError, match="start is missing"):
        function.fill_defaults([None] * 6)
    start, velocity = case.values["start"], case.values["velocity"]
    mass, friction, contact, *_, pose = function.fill_defaults(
        [None, None, None, start, velocity, None]
    )
    uniform = CellParameters.uniform(case.obj)
    np.testing.assert_array_equal(mass, uniform.mass)
    np.testing.assert_array_equal(friction, uniform.friction)
    assert contact == uniform.contact_friction
    assert (np.asarray(pose) == 0).all()
