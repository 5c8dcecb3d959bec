"""Whether a learned model may be trusted, by the pushes it was learned from and what was known.

`describe_poor_fit` says in sentences what speaks against it. How far off predictions may be is in
`spread`.
"""

import numpy as np

from gridpush_drake.identification.model import Model
from gridpush_drake.identification.prediction import calc_mean_cell_error
from gridpush_drake.identification.result import Identification, IdentificationStatus
from gridpush_drake.identification.statistics.center_of_mass import CenterOfMass
from gridpush_drake.identification.statistics.outliers import remove_outliers
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.units import MM_PER_M

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
    used = _select_used(result, log)
    before = calc_mean_cell_error(Model(result.obj, physics=result.physics), used)
    after = calc_mean_cell_error(result, used)
    return before, after


def describe_poor_fit(result: Identification) -> str | None:
    """Says in sentences why a model should not be trusted; None where nothing speaks against it.

    That is a model that explains too little of the pushes it was learned from (its status is then
    "explains_little"), and a center of friction too far from the center of mass told.
    """
    if not result.push_names:
        return None
    poor = result.status == IdentificationStatus.EXPLAINS_LITTLE
    conflicts = (result.message if poor else None, describe_center_conflict(result))
    return " ".join(filter(None, conflicts)) or None


def describe_center_conflict(result: Identification) -> str | None:
    """Says that the center of friction is too far from the center of mass that was told.

    Returns:
        The sentences; None where both agree, or no center of mass was told.
    """
    given_center = CenterOfMass.of_prior(result.obj.prior)
    z = result.posterior.mean
    if given_center is None:
        return None
    # In standard deviations: frictions that scatter move the center of friction, too (section 4).
    off, _ = given_center.linearize(result.obj, z, given_center.make_whitening(result.obj, z)[0])
    if np.linalg.norm(off) < CONTRADICTION_SIGMAS:
        return None
    x, y = given_center.at
    distance = float(np.linalg.norm(result.identifiability.center_of_friction - given_center.at))
    return (
        f"The pushes put the center of friction {distance * MM_PER_M:.1f} mm "
        f"from the center of mass that was told, [{x:g}, {y:g}] m. Is center_of_mass.at right?"
    )


def _select_used(result: Identification, log: PushLog) -> PushLog:
    """Selects the pushes learned from, without what was refused of them."""
    used = remove_outliers(log, result.outliers)
    return used.subset([i for i, seen in enumerate(used) if seen.name in result.push_names])


def judge_fit(result: Identification, used: PushLog) -> tuple[IdentificationStatus, str] | None:
    """Says that a model is far off where pushes ended, or no better than an even object.

    Args:
        result: the model; the regime of its physics is not "auto".
        used: the pushes that it was learned from, without what was refused of them.

    Returns:
        The status that it deserves, and why, in sentences; None where nothing is wrong with it.
    """
    if not len(used):
        return None
    obj = result.obj

    # How far the pushes moved the object's cells on average: what a model without any skill, by
    # which nothing moves, would be off by.
    moved = []
    for seen in used:
        cells = obj.cells_at([seen.pose, seen.final_pose])
        moved.append(np.linalg.norm(np.diff(cells, axis=0), axis=2).mean())
    mean = float(np.mean(moved))

    # By how much the model is off, in the same measure, and by how much an even object is.
    error = calc_mean_cell_error(result, used)
    even = calc_mean_cell_error(Model(obj, physics=result.physics), used)
    off = (
        f"it is off by {error * MM_PER_M:.1f} mm on average, an even object by "
        f"{even * MM_PER_M:.1f} mm, "
        f"while the object moves by {mean * MM_PER_M:.1f} mm."
    )
    if error > POOR_ERROR_FRACTION * mean or error > even + result.noise_std:
        return (
            IdentificationStatus.EXPLAINS_LITTLE,
            f"This model explains these pushes poorly: {off} "
            "Is object_theta in rad and counterclockwise, are all poses in one frame, "
            f"and are all pushes of {obj.name} and its outline right?",
        )
    if error > even:
        return (
            IdentificationStatus.PRIOR_KEPT,
            f"This model predicts these pushes no better than an even object would: {off}",
        )
    return None
