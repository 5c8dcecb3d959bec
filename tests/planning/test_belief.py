"""`Belief`: of one object and of several, the estimate and the models that all decisions draw."""

from dataclasses import replace

import numpy as np
import pytest

from gridpush_drake.errors import PlanningError, SimulationError
from gridpush_drake.identification.fit.hypotheses import SmoothField
from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.multi_object.joint_fit import JointEnsemble
from gridpush_drake.planning.belief import SEVERAL_DRAWS, Belief
from gridpush_drake.pushes.push_log import PushLog
from tests.helpers.made_identifications import make_identification
from tests.helpers.two_blocks import NOISE, make_truth, push_scene


@pytest.fixture(scope="module")
def joint():
    """Two blocks that were learned together."""
    truth = make_truth()
    log = PushLog([push_scene(truth, seed) for seed in range(2)], names=("one", "other"))
    return identify(Model(truth.objects), log, JointEnsemble(NOISE, (SmoothField(0.7),)))


def test_one_object_and_several_have_their_models_drawn_from_what_was_learned(joint):
    several = Belief.of_identification(joint, seed=3)
    assert several.bodies is joint and len(several.samples) == SEVERAL_DRAWS
    for drawn, expected in zip(several.samples, joint.draws(SEVERAL_DRAWS, 3), strict=True):
        for params, one in zip(drawn.parameters, expected.parameters, strict=True):
            np.testing.assert_array_equal(params.mass, one.mass)
    found = make_identification()
    alone = Belief.of_identification(found, sample_count=2, seed=3)
    for drawn, expected in zip(alone.samples, found.draws(2, 3), strict=True):
        np.testing.assert_array_equal(drawn.params.mass, expected.mass)
        assert drawn.physics is alone.physics


def test_what_was_learned_of_an_object_alone_stands_before_what_was_together(joint):
    both = Belief.of_identification(joint, sample_count=0)
    assert both.identifications == joint.parts
    alone = Belief.of_identification(make_identification())
    assert alone.identifications == (alone.identification,)
    known = replace(both, alone={1: alone})
    assert known.identifications == (joint.parts[0], alone.identification)
    assert known.forget([0]).identifications == known.identifications
    assert known.forget([1]).identifications == joint.parts


def test_what_is_of_one_object_alone_is_refused_of_several(joint):
    both = Belief.of_identification(joint)
    with pytest.raises(SimulationError, match="there are 2 objects"):
        _ = both.masses
    with pytest.raises(PlanningError, match="several objects"):
        both.require_posterior()
    assert both.inflate(2.0) is both
