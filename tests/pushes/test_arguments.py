"""A push log's file will do where a log is wanted, and swapped arguments are named."""

from dataclasses import replace

import numpy as np
import pytest

from gridpush_drake import Model, PushLog, identify, predict
from gridpush_drake.errors import PushLogError
from gridpush_drake.identification.spread import predict_spread
from gridpush_drake.multibody.ground_truth import sample_ground_truth
from tests.helpers.made_identifications import make_block, make_identification
from tests.helpers.simulated_pushes import make_pushes

RADIUS = 0.006


@pytest.fixture(scope="module")
def obj():
    block = make_block()
    return replace(block, prior=replace(block.prior, pusher_radius=RADIUS))


@pytest.fixture(scope="module")
def log(obj):
    return make_pushes(obj, sample_ground_truth(obj, 1), 3, seed=1)


@pytest.fixture(params=[str, lambda path: path], ids=["str", "Path"])
def file(request, log, tmp_path):
    log.write_csv(tmp_path / "pushes.csv")
    return request.param(tmp_path / "pushes.csv")


def test_a_file_is_as_good_as_the_log_in_it(obj, file):
    log = PushLog.read_csv(file, radius=RADIUS)
    learned, of_file = identify(Model(obj), log), identify(Model(obj), file)
    np.testing.assert_array_equal(of_file.params.mass, learned.params.mass)
    for one, other in zip(
        predict(Model(obj, learned.params), log),
        predict(Model(obj, learned.params), file),
        strict=True,
    ):
        np.testing.assert_array_equal(one.poses, other.poses)
    for one, other in zip(predict_spread(learned, log), predict_spread(learned, file), strict=True):
        np.testing.assert_array_equal(one.std, other.std)


def test_a_file_that_is_not_there_is_named(obj):
    with pytest.raises(PushLogError, match=r"none\.csv: cannot be read"):
        identify(Model(obj), "none.csv")


def test_swapped_arguments_are_named(obj, log):
    swapped = "the arguments are swapped; expected"
    model = Model(obj)
    with pytest.raises(
        TypeError,
        match=rf"^identify: model is a PushLog and log is a Model: {swapped} identify\(model, log\)$",
    ):
        identify(log, model)
    with pytest.raises(TypeError, match=rf"{swapped} identify\(model, log\)"):
        identify("pushes.csv", model)
    with pytest.raises(TypeError, match=rf"{swapped} predict\(model, log\)"):
        predict(log, model)
    with pytest.raises(TypeError, match=rf"{swapped} predict_spread\(model, log\)"):
        predict_spread(log, make_identification())


def test_other_things_are_named(obj, log):
    with pytest.raises(
        TypeError,
        match=r"model is a GridObject; expected for model a Model, such as Model\(obj\)",
    ):
        identify(obj, log)
    with pytest.raises(TypeError, match="objects is a str; expected a GridObject"):
        Model("claw_hammer")
    with pytest.raises(TypeError, match=r"log is a list; .* PushLog\(pushes\) makes a log"):
        identify(Model(obj), list(log))
    with pytest.raises(TypeError, match="log is a NoneType; expected for log a PushLog"):
        identify(Model(obj), None)
