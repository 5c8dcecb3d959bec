"""An outline whose frame is off the one in which the object's poses are logged."""

from dataclasses import replace

import numpy as np
import pytest

from gridpush_drake.errors import IdentificationError, PushLogWarning
from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.model_file import read_model, write_model
from gridpush_drake.identification.prediction import calc_final_errors
from gridpush_drake.objects.grid_object import GridObject, PhysicalPrior
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.pushes.push_log import PushLog
from tests.helpers.made_logs import log_elsewhere
from tests.helpers.shapes import make_shape
from tests.identification.simulated_pokes import make_pokes

SHIFT = np.array([0.006, -0.004, np.deg2rad(3.0)])
"""Where the outline's frame is in the log's."""


@pytest.fixture(scope="module", params=["block", "claw_hammer"])
def case(request):
    """An object, and pushes of it to learn from and to predict, in the frame of the outline."""
    if request.param == "block":
        side = [[-0.06, -0.03], [0.06, -0.03], [0.06, 0.03], [-0.06, 0.03]]
        obj = GridObject.from_outline(side, max_cells=18)
    else:
        obj = make_shape("claw_hammer", 40)
    obj = replace(obj, prior=PhysicalPrior(pusher_radius=0.008, center_of_mass=None))
    truth = CellParameters.random(obj, 3, by="cell", mass_range=(0.02, 0.2))
    log = make_pokes(obj, truth, 8, 21, noise=(5e-4, 3.5e-3))
    return obj, log, make_pokes(obj, truth, 20, 22, observations=1)


def calc_errors(model: Model, log: PushLog) -> np.ndarray:
    errors = calc_final_errors(model.obj, model.predict(log), log)
    return np.array([error.cell for error in errors if error is not None])


def calc_deviations(obj: GridObject, frame: np.ndarray) -> np.ndarray:
    assert obj.outline_pose is not None
    return (np.array(obj.outline_pose.pose) - frame) / obj.outline_pose.std


def test_a_frame_that_is_off_is_found_and_costs_nothing(case) -> None:
    obj, log, held_out = case
    shifted = log_elsewhere(log, SHIFT)
    shifted_held_out = log_elsewhere(held_out, SHIFT)
    found = identify(Model(obj), shifted, fit_frame=True)
    assert found.status == "learned"
    assert np.abs(calc_deviations(found.obj, SHIFT)).max() < 2
    # the errors that are stated are small enough to tell the frame
    assert (np.abs(SHIFT) > 2 * np.array(found.obj.outline_pose.std)).all()

    errors = calc_errors(found, shifted_held_out)
    right = calc_errors(identify(Model(obj), log), held_out)
    more = errors - right
    assert more.mean() < max(more.std(ddof=1) / np.sqrt(len(more)), 2e-4)
    with pytest.warns(PushLogWarning, match="identify --fit-frame learns where it lies"):
        without = calc_errors(identify(Model(obj), shifted), shifted_held_out)
    worse = without - errors
    assert worse.mean() > 3 * worse.std(ddof=1) / np.sqrt(len(worse))
    assert without.mean() > 1.5 * errors.mean()


def test_a_frame_that_is_right_stays(case) -> None:
    obj, log, _ = case
    found = identify(Model(obj), log, fit_frame=True)
    assert np.abs(calc_deviations(found.obj, np.zeros(3))).max() < 2


def test_a_model_file_keeps_the_frame(case, tmp_path) -> None:
    obj, log, held_out = case
    found = identify(Model(obj), log_elsewhere(log, SHIFT), fit_frame=True)
    write_model(tmp_path / "model.yaml", found)
    again = read_model(tmp_path / "model.yaml")
    assert again.obj.outline_pose == found.obj.outline_pose
    found.obj.write_yaml(tmp_path / "object.yaml")
    assert GridObject.from_yaml(tmp_path / "object.yaml").outline_pose == found.obj.outline_pose
    shifted = log_elsewhere(held_out, SHIFT)
    np.testing.assert_array_equal(calc_errors(again, shifted), calc_errors(found, shifted))


def test_what_the_frame_leaves_open_is_in_the_spread(case) -> None:
    obj, log, _ = case
    found = identify(Model(obj), log, fit_frame=True)
    known = identify(Model(found.obj), log)
    np.testing.assert_array_equal(known.posterior.mean, found.posterior.mean)
    wider = found.posterior.covariance - known.posterior.covariance
    assert np.linalg.eigvalsh(wider).min() > -1e-9
    spread, narrow = (
        one.identifiability.center_of_friction_covariance.diagonal() for one in (found, known)
    )
    assert (spread > 1.05 * narrow).any() and (spread > narrow).all()


def test_a_search_cannot_find_a_frame(case) -> None:
    obj, log, _ = case
    with pytest.raises(IdentificationError, match="fit_frame: the method paper cannot"):
        identify(Model(obj), log, "paper", fit_frame=True)
