"""A model is corrected while its object is pushed, by an ensemble of models."""

from dataclasses import replace

import numpy as np
import pytest

from gridpush_drake.dynamics.kernels.steering.finger_push import (
    STATE_SIZE,
    THETA,
    TIP_X,
    TIP_Y,
    X,
    follow_tip,
)
from gridpush_drake.errors import PlanningError
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.feedback import (
    FollowOptions,
    PosePath,
    PoseSensorModel,
    PushFollower,
    SteeredFinger,
    follow,
)
from gridpush_drake.planning.feedback.model_ensemble import EnsembleOptions, ModelEnsemble
from gridpush_drake.planning.feedback.pose_path import PathProgress
from gridpush_drake.planning.pushed_object import FeedbackFinger, make_model
from gridpush_drake.planning.world import SimulatedWorld
from tests.helpers.made_identifications import make_block

OBJ = make_block(12)
RADIUS = 0.01
FINGER = FeedbackFinger(RADIUS)
TRUTH = CellParameters.by_part(OBJ, {1: 0.03, 2: 0.3}, 0.4, 0.4)
EVEN = CellParameters.uniform(OBJ)


def draw_models(count, seed=0):
    """Models whose masses are drawn about the even one's, which agree with nothing that was seen."""
    rng = np.random.default_rng(seed)
    scale = np.exp(0.8 * rng.standard_normal((count, OBJ.n)))
    return [replace(EVEN, mass=EVEN.mass * row * OBJ.n / row.sum()) for row in scale]


def push_across(model, offset, length=0.06):
    """Pushes the block in y at some x; returns poses (K, 3) and the finger's path (K, 2)."""
    state = np.zeros(STATE_SIZE)
    state[TIP_X : TIP_Y + 1] = (offset, -0.03 - RADIUS)
    tips = np.column_stack([np.full(60, offset), np.linspace(-0.04, -0.04 + length, 60)])
    poses = np.empty((len(tips), 3))
    for pose, tip in zip(poses, tips, strict=True):
        follow_tip(model, state, tip[None])
        pose[:] = state[X : THETA + 1]
    return poses, tips


def measure_error(model, offset):
    """How far a model is off from the truth at the end of a push, m."""
    told, _ = push_across(model, offset)
    true, _ = push_across(make_model(OBJ, TRUTH, RADIUS), offset)
    off = told[-1] - true[-1]
    return float(np.hypot(np.hypot(*off[:2]), OBJ.radius_of_gyration * off[2]))


def correct(ensemble, offset):
    """Lets an ensemble see a push of the true object."""
    poses, tips = push_across(make_model(OBJ, TRUTH, RADIUS), offset)
    ensemble.forget()
    for at in range(0, len(tips), 3):
        ensemble.add(0.02 * at, poses[at], tips[max(at - 2, 0) : at + 1])


def test_pushes_that_were_seen_make_the_prediction_of_another_push_better():
    ensemble = ModelEnsemble(OBJ, EVEN, draw_models(32), FINGER)
    before = measure_error(ensemble.models[0], 0.01)
    for offset in (-0.02, 0.03, 0.0):
        correct(ensemble, offset)
    assert ensemble.corrections > 6
    assert measure_error(ensemble.models[0], 0.01) < 0.35 * before
    # the models about the estimate come nearer as well, and still differ
    errors = [measure_error(model, 0.01) for model in ensemble.models[1:9]]
    assert np.mean(errors) < 0.6 * before
    assert np.ptp(errors) > 0.0


def test_with_the_true_model_nothing_is_corrected_by_much():
    rng = np.random.default_rng(1)
    scale = np.exp(0.3 * rng.standard_normal((16, OBJ.n)))
    draws = [replace(TRUTH, mass=TRUTH.mass * row) for row in scale]
    ensemble = ModelEnsemble(OBJ, TRUTH, draws, FINGER)
    correct(ensemble, 0.0)
    assert ensemble.corrections > 2
    assert measure_error(ensemble.models[0], 0.01) < 5e-4


def test_without_draws_or_motion_nothing_is_corrected():
    alone = ModelEnsemble(OBJ, EVEN, [], FINGER)
    correct(alone, 0.0)
    assert alone.corrections == 0
    ensemble = ModelEnsemble(OBJ, EVEN, draw_models(8), FINGER)
    still = np.array([[-0.2, 0.0]])
    for at in range(200):
        assert not ensemble.add(0.02 * at, np.zeros(3), still)
    # nor by a shove, which is forgotten
    ensemble.forget()
    ensemble.add(5.0, np.array([0.03, 0.0, 0.3]), still)
    assert ensemble.corrections == 0


def test_a_copy_goes_on_by_itself():
    ensemble = ModelEnsemble(OBJ, EVEN, draw_models(8), FINGER)
    correct(ensemble, 0.0)
    other = ensemble.copy()
    models = list(ensemble.models)
    correct(other, 0.03)
    assert other.corrections > ensemble.corrections
    assert all(a is b for a, b in zip(models, ensemble.models, strict=True))


def test_refuses_options_that_make_no_sense():
    with pytest.raises(PlanningError, match="ensemble: motion is 0"):
        EnsembleOptions(motion=0.0)


def follow_arc(ensemble):
    """Follows an S with an even model of an uneven block; returns the RMS distance, m."""
    s = np.linspace(0.0, 0.3, 40)
    center = OBJ.p_BC.mean(axis=0)
    points = center + np.column_stack([s, 0.02 * (1 - np.cos(2 * np.pi * s / 0.3))])
    path = PosePath.through(OBJ, points, 0.05)
    options = FollowOptions(strokes=40, changes=60, draws=2, ensemble=ensemble)
    follower = PushFollower(OBJ, EVEN, path, FINGER, draws=draw_models(24), options=options)
    steered = SteeredFinger(
        SimulatedWorld(Model(OBJ, TRUTH), np.zeros(3)), (-0.09, 0.0), RADIUS, PoseSensorModel(), 3
    )
    run = follow(follower, steered, 12.0)
    centers = np.array([OBJ.cells_at(pose).mean(axis=0) for pose in run.poses])
    return float(np.sqrt((PathProgress(OBJ, path).measure_distance(centers) ** 2).mean()))


@pytest.mark.slow
def test_a_path_is_kept_better_where_the_model_is_corrected():
    assert follow_arc(24) < 0.7 * follow_arc(0)
