"""Whether a learned model may be trusted, by the pushes it was learned from and what was known.

`sentences` says it in words. How far off predictions may be is in `spread`.
"""

from dataclasses import dataclass

import numpy as np

from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.fit.learning_task import Found
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.prediction import calc_final_cell_errors
from gridpush_drake.identification.result import Identification, IdentificationStatus
from gridpush_drake.identification.statistics.center_of_mass import CenterOfMass
from gridpush_drake.identification.statistics.outliers import remove_outliers, weigh_pushes
from gridpush_drake.pushes.plausibility import explain_unused_forces
from gridpush_drake.pushes.push_log import PushLog

POOR_ERROR_FRACTION = 0.2
"""Largest error of the pushes learned from, as a fraction of how far the object moves. A model with
a larger error explains little."""

CONTRADICTION_SIGMAS = 4.0
"""Distance, in standard deviations, of the center of friction from the center of mass that was
told, beyond which the pushes contradict that center of mass."""


def calc_training_errors(result: Identification, log: PushLog) -> tuple[float, float]:
    """Calculates how far off the final poses of the pushes learned from are predicted.

    Returns:
        Mean cell errors, m: with uniform parameters, as before any push, and as learned.
    """
    even_errors, errors = _calc_errors(result, select_used(result, log))
    return float(np.mean(even_errors)), float(np.mean(errors))


def _calc_errors(result: Identification, used: PushLog) -> tuple[Array, Array]:
    """Calculates the errors of `calc_training_errors`, of each push (P,) that was used."""
    even = Model(result.obj, physics=result.physics)
    return calc_final_cell_errors(even, used), calc_final_cell_errors(result, used)


def find_center_conflict(result: Identification) -> float | None:
    """Finds whether the center of friction is too far from the center of mass that was told.

    Returns:
        How far it is, m; None where both agree, or no center of mass was told.
    """
    given_center = CenterOfMass.of_prior(result.obj.prior)
    z = result.posterior.mean
    if given_center is None:
        return None
    # In standard deviations: frictions that scatter move the center of friction, too (section 4).
    off, _ = given_center.linearize(result.obj, z, given_center.make_whitening(result.obj, z)[0])
    if np.linalg.norm(off) < CONTRADICTION_SIGMAS:
        return None
    return float(np.linalg.norm(result.identifiability.center_of_friction - given_center.at))


def select_used(result: Identification, log: PushLog) -> PushLog:
    """Selects the pushes learned from, without what was refused of them."""
    used = remove_outliers(log, result.outliers)
    return used.subset([i for i, seen in enumerate(used) if seen.name in result.push_names])


@dataclass(frozen=True)
class FitCheck:
    """How far off a model is from the pushes that it was learned from.

    All are means over the pushes, in which those that neither the model nor an even object explains
    count little (`weigh_pushes`).

    Attributes:
        error: mean cell error of the model, m.
        even_error: that of an even object, m.
        motion: how far the pushes moved the object's cells on average, m: the error of a model
            without any skill, by which nothing moves.
        noise_std: standard deviation of what the model leaves unexplained, m.
    """

    error: float
    even_error: float
    motion: float
    noise_std: float

    @property
    def status(self) -> IdentificationStatus | None:
        """The status that such a model deserves; None where nothing is wrong with it."""
        worse = self.error > self.even_error + self.noise_std
        if self.error > POOR_ERROR_FRACTION * self.motion or worse:
            return IdentificationStatus.EXPLAINS_LITTLE
        return IdentificationStatus.PRIOR_KEPT if self.error > self.even_error else None


def check_fit(result: Identification, used: PushLog) -> FitCheck | None:
    """Checks a model by the pushes that it was learned from.

    Args:
        result: the model; the regime of its physics is not "auto".
        used: its pushes, without what was refused of them.

    Returns:
        How far off it is; None where there are no pushes.
    """
    if not len(used):
        return None
    obj = result.obj
    moved = []
    for seen in used:
        cells = obj.cells_at([seen.pose, seen.final_pose])
        moved.append(np.linalg.norm(np.diff(cells, axis=0), axis=2).mean())
    even_errors, errors = _calc_errors(result, used)
    weights = weigh_pushes([even_errors, errors], result.noise.pose)
    return FitCheck(
        error=float(np.average(errors, weights=weights)),
        even_error=float(np.average(even_errors, weights=weights)),
        motion=float(np.average(moved, weights=weights)),
        noise_std=result.noise_std,
    )


@dataclass(frozen=True, eq=False)
class FitJudgment:
    """What speaks against a model and its log.

    Attributes:
        status: how learning ended, all in all.
        against: how far off the model is, where that speaks against it; else None.
        unused_forces: why measured forces are not learned from; None where they are.
    """

    status: IdentificationStatus
    against: FitCheck | None
    unused_forces: str | None


def judge(found: Found) -> FitJudgment:
    """Judges what was learned of one object, by the pushes that it was learned from."""
    model = found.alone
    used = found.screened.log
    check = check_fit(model, used)
    status = None if check is None else check.status
    # That an even object does as well says nothing new of a model whose learning did not end well.
    if status == IdentificationStatus.PRIOR_KEPT and model.status != IdentificationStatus.LEARNED:
        status = None
    return FitJudgment(
        status=status or model.status,
        against=None if status is None else check,
        unused_forces=explain_unused_forces([model.obj], used, model.physics.inertial),
    )
