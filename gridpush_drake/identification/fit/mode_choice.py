"""Which of many modes of the load the pushes speak for: cuts between two parts, or rings.

A mode h adds a rank of one to the prior covariance S of z. About the best fit so far the pushes are
linear, r = r_0 + J (z - z_0), whitened. With L L^T = I + J S J^T and g = sigma L^-1 J h, the mode
raises the log evidence by

    1/2 ((g^T L^-1 r_0)² / (1 + g^T g) - log(1 + g^T g))

The best modes that are not alike are proposed. For the best of a hundred explains the pushes better
than an average one just by luck, its evidence stands for the average over all modes
(`docs/theory/identification.md`, section 5). The modes themselves are found in `load_modes`.
"""

import numpy as np
from scipy.linalg import block_diag, solve_triangular

from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.fit.linearized_fit import factorize
from gridpush_drake.identification.fit.load_prior import (
    HypothesisInputs,
    LinearizedPushes,
    LoadPrior,
    calc_prior_factor,
)
from gridpush_drake.identification.statistics.posterior import CELL_ENTRIES

ALIKE_CORRELATION = 0.8
"""Two cuts whose h are correlated by more than this are alike, and only the better one is
fitted."""


def propose_modes(
    setting: HypothesisInputs,
    modes: Array,
    *,
    weight: float,
    mode_std: float,
    amplitude: float,
    range_cells: float,
    most: int,
) -> list[LoadPrior]:
    """Proposes those of many modes h that explain the pushes best to first order, no two alike.

    The prior with a mode is log k ~ N(log k_0, amplitude² C + mode_std² h h^T).

    Args:
        setting: the object, with the training pushes.
        modes: (modes, n) h of each; there may be none.
        weight: prior weight of all modes together.
        mode_std: standard deviation of log k along h.
        amplitude: standard deviation of log k beside it.
        range_cells: correlation range beside it, cells.
        most: how many modes are proposed at most.

    Returns:
        One prior a mode, the best one first.
    """
    assert setting.pushes is not None
    pushes = reduce_rows(setting.pushes)
    residuals = pushes.residuals
    J = pushes.J
    known = pushes.known
    C = setting.calc_smooth_covariance(range_cells)
    within = block_diag(amplitude**2 * C, setting.log_contact_friction_std**2)
    log_evidence = calc_cut_evidence(modes, mode_std, within, residuals, J)
    if known:  # what is told of the center of mass is no evidence for a mode
        known_entries = slice(-known, None)
        log_evidence -= calc_cut_evidence(
            modes, mode_std, within, residuals[known_entries], J[known_entries]
        )
    left = np.ones(len(modes), dtype=bool)
    found: list[LoadPrior] = []
    while left.any() and len(found) < most:
        best = int(np.argmax(np.where(left, log_evidence, -np.inf)))
        alike = left & (_correlate(modes, modes[best]) > ALIKE_CORRELATION)
        covariance = within[CELL_ENTRIES, CELL_ENTRIES] + mode_std**2 * np.outer(
            modes[best], modes[best]
        )
        A = calc_prior_factor(covariance, 1.0, setting.log_contact_friction_std)
        # The evidence of this mode stands for the average over all modes, to which those like it
        # contribute as much less as they are less probable.
        fraction = float(np.exp(log_evidence[alike] - log_evidence[best]).sum() / len(modes))
        found.append(
            LoadPrior(
                mean=setting.z0,
                factor=A,
                weight=weight,
                p_BC=setting.obj.p_BC,
                evidence_fraction=fraction,
                start=setting.z0 + calc_linear_step(pushes, A),
            )
        )
        left &= ~alike
    return found


def calc_linear_step(pushes: LinearizedPushes, A: Array) -> Array:
    """Calculates z - z_0 (n+1,) where linear pushes put z under a prior N(z_0, A A^T).

    A fit that begins there comes to an end nearby.
    """
    B = pushes.J @ A
    return -A @ (B.T @ np.linalg.solve(np.eye(len(B)) + B @ B.T, pushes.residuals))


def reduce_rows(pushes: LinearizedPushes) -> LinearizedPushes:
    """Replaces the residuals of pushes by no more than there are unknowns, by a QR factorization.

    They tell the same of the unknowns: every normal prior of z has the same evidence and the same
    optimum with both, but for a constant that all priors share.
    """
    residuals = pushes.residuals
    J = pushes.J
    known = pushes.known
    if len(residuals) <= J.shape[1]:
        return pushes
    seen = len(residuals) - known
    stacked = np.column_stack([J[:seen], residuals[:seen]])
    rotated = np.asarray(np.linalg.qr(stacked, mode="r"))
    return LinearizedPushes(
        residuals=np.append(rotated[:, -1], residuals[seen:]),
        J=np.vstack([rotated[:, :-1], J[seen:]]),
        known=known,
    )


def calc_cut_evidence(
    cuts: Array, part_std: float, within: Array, residuals: Array, J: Array
) -> Array:
    """Calculates how much more the pushes speak for each cut than for none, to first order.

    A cut adds one rank to the prior covariance (section 5 of the theory).

    Args:
        cuts: (cuts, n) h of each.
        part_std: sigma_p.
        within: (n+1, n+1) prior covariance of z without a cut.
        residuals: (R,) at z_0, whitened.
        J: (R, n+1) their derivatives by z.

    Returns:
        (cuts,) log evidence of each cut, less that of no cut.
    """
    L = np.tril(factorize(np.eye(len(residuals)) + J @ within @ J.T)[0][0])
    r = solve_triangular(L, residuals, lower=True)
    g = part_std * solve_triangular(L, J[:, CELL_ENTRIES] @ cuts.T, lower=True)
    size2 = 1 + (g * g).sum(axis=0)
    return np.asarray(0.5 * ((r @ g) ** 2 / size2 - np.log(size2)))


def _correlate(cuts: Array, cut: Array) -> Array:
    """Absolute correlation (cuts,) of each cut with one of them."""
    a = cuts - cuts.mean(axis=1, keepdims=True)
    b = cut - cut.mean()
    return np.asarray(np.abs(a @ b) / np.sqrt((a * a).sum(axis=1) * (b @ b)))
