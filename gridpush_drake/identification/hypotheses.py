"""Hypotheses of how an object bears on the table: the open list that the default identifier weighs.

No outline tells which cells bear how much. A hypothesis is one idea of it. It is an object with a
name and the method `propose`, which turns the idea into one or several normal priors of
z = (log k, log mu_c). `MapEnsemble` fits every prior to the pushes and weighs the fits by their
evidence; it knows neither how many hypotheses there are nor what they say.

Shipped are

* `SmoothField`: log k ~ N(log k_0, a² C), neighboring cells alike, of one amplitude a;
* `TwoParts`: two parts, as of steel and of wood, that meet at a straight cut. With h = 1/2 on one
  side of the cut and -1/2 on the other,

      log k ~ N(log k_0, a_p² C + sigma_p² h h^T)

* `RigidBottom`: a flat rigid bottom, which stands on corners of the outline's convex hull;
* `Concentrated`: the load is gathered in the middle, or out at the rim. With q the squared distance
  from the middle, standardized over the cells,

      log k ~ N(log k_0, a_r² C + sigma_r² q q^T);

* `Ring`: the load lies in a ring about the middle, h = exp(-(d - r)² / (2 w²)), standardized, with
  d the distance from the middle,

      log k ~ N(log k_0, a_o² C + sigma_o² h h^T)

A further hypothesis is a class with the attributes and the method of `LoadHypothesis`, passed as
`identify(..., ensemble=MapEnsemble(hypotheses=(*DEFAULT_HYPOTHESES, Mine())))`. Theory:
`docs/theory/identification.md`, sections 3 and 5. The fits themselves are made in `map_fit`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Protocol

import numpy as np
from scipy.linalg import block_diag, solve_triangular

from gridpush_drake.errors import IdentificationError
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.load_modes import (
    calc_radius_mode,
    find_corners,
    find_cuts,
    find_rings,
)
from gridpush_drake.identification.posterior import CELLS
from gridpush_drake.objects.grid_object import GridObject

RANGE_CELLS = 4.0
"""Distance, in cells, at which the log-frictions of two cells are nearly independent."""

KAPPA_RANGE = 8.0**0.5
"""kappa times the correlation range of the Matérn field of smoothness one (Lindgren, Rue and
Lindström 2011, section 2)."""

AMPLITUDES = (0.05, 0.3, 0.7, 1.5, 3.0, 6.0)
"""Standard deviations of log k of the shipped smooth fields; the first is an almost even object."""

EVEN_AMPLITUDE = 0.1
"""A smooth field whose cells differ by no more than this standard deviation of log k stands for an
even object."""

WEAKNESS = 0.65
"""A smooth field of amplitude a has the prior weight a^-WEAKNESS, so that a few noisy pushes do not
talk the model out of an even object."""

CENTER_STD = 0.6
"""Standard deviation per axis of the center of friction about the cells' centroid where nothing is
known of the center of mass, in radii of gyration."""

ALIKE = 0.8
"""Two cuts whose h are correlated by more than this are alike, and only the better one is
fitted."""


@dataclass(frozen=True, eq=False)
class LoadPrior:
    """One normal prior of z, z ~ N(mean, factor factor^T), as a hypothesis proposes it.

    Attributes:
        mean: (n+1,) prior mean of z.
        factor: (n+1, n+1) lower triangular factor of the prior covariance of z.
        weight: prior weight, relative to those of all other priors.
        p_BC: (n, 2) points at which the cells bear their loads, m, body frame; the object's own
            `p_BC` itself where they bear them at their centers.
        evidence_share: factor on the evidence of this prior's fit. It is less than 1 where the
            prior is the best one of many that were tried.
        start: (n+1,) z at which the fit begins; None for the prior mean.
        stands_for_even: whether the prior describes an almost even object.
    """

    mean: Array
    factor: Array
    weight: float
    p_BC: Array
    evidence_share: float = 1.0
    start: Array | None = None
    stands_for_even: bool = False


@dataclass(frozen=True, eq=False)
class LinearizedPushes:
    """Pushes to first order about the prior mean z_0: r = residuals + J (z - z_0) ~ N(0, I).

    Attributes:
        residuals: (R,) whitened residuals at z_0.
        J: (R, n+1) their derivatives by z.
        known: how many of the residuals, the last ones, are prior knowledge of the center of mass
            and no evidence.
    """

    residuals: Array
    J: Array
    known: int = 0


@dataclass(frozen=True, eq=False)
class Setting:
    """What every hypothesis is told when it proposes its priors.

    Attributes:
        obj: the object.
        z0: (n+1,) z of the even object, log k_0 and log mu_c.
        log_contact_friction_std: prior standard deviation of log mu_c.
        pushes: the training pushes to first order, for hypotheses that ask for them
            (`LoadHypothesis.needs_pushes`); else None.
    """

    obj: GridObject
    z0: Array
    log_contact_friction_std: float
    pushes: LinearizedPushes | None = None

    @cached_property
    def _covariances(self) -> dict[float, Array]:
        return {}

    def calc_smooth_covariance(self, range_cells: float) -> Array:
        """C (n, n) of a correlation range in cells; it is calculated once."""
        if range_cells not in self._covariances:
            self._covariances[range_cells] = calc_smooth_covariance(self.obj, range_cells)
        return self._covariances[range_cells]

    def with_pushes(self, pushes: LinearizedPushes) -> "Setting":
        """Makes this setting one with the training pushes to first order."""
        setting = Setting(self.obj, self.z0, self.log_contact_friction_std, pushes)
        setting._covariances.update(self._covariances)
        return setting


class LoadHypothesis(Protocol):
    """One idea of how an object bears on the table.

    Attributes:
        name: short name, unique in an ensemble; results and reports show it.
        needs_pushes: whether `propose` looks at `Setting.pushes`. Such hypotheses are asked last,
            with the pushes made linear about the best fit of the others.
    """

    @property
    def name(self) -> str:
        """Short name, unique in an ensemble."""
        ...

    @property
    def needs_pushes(self) -> bool:
        """Whether `propose` looks at `Setting.pushes`."""
        ...

    def propose(self, setting: Setting) -> Sequence[LoadPrior]:
        """Proposes priors of z for an object; none where the idea does not apply to it."""
        ...


def _check_positive(hypothesis: "SmoothField | Concentrated | Ring") -> None:
    """Raises IdentificationError: a number of a hypothesis is not positive and finite."""
    for field in fields(hypothesis):
        value = getattr(hypothesis, field.name)
        if not 0 < value < np.inf:
            raise IdentificationError(
                f"{type(hypothesis).__name__}: {field.name} is {value}; "
                "expected a positive finite number"
            )


@dataclass(frozen=True)
class SmoothField:
    """Neighboring cells bear alike: log k ~ N(log k_0, a² C).

    The smooth fields of an ensemble are fitted in the order of their amplitudes, each from where
    the last one ended: coarse to fine.

    Attributes:
        amplitude: a, standard deviation of log k.
        range_cells: correlation range, cells.
    """

    amplitude: float
    range_cells: float = RANGE_CELLS

    def __post_init__(self) -> None:
        """Raises IdentificationError: a number is not positive and finite."""
        _check_positive(self)

    @property
    def name(self) -> str:
        """Short name, with the amplitude."""
        return f"smooth field {self.amplitude:g}"

    @property
    def needs_pushes(self) -> bool:
        """False: the prior is the same for all pushes."""
        return False

    def propose(self, setting: Setting) -> list[LoadPrior]:
        """Proposes the smooth field."""
        prior = LoadPrior(
            mean=setting.z0,
            factor=calc_prior_factor(
                setting.calc_smooth_covariance(self.range_cells),
                self.amplitude,
                setting.log_contact_friction_std,
            ),
            weight=self.amplitude**-WEAKNESS,
            p_BC=setting.obj.p_BC,
            stands_for_even=self.amplitude <= EVEN_AMPLITUDE,
        )
        return [prior]


@dataclass(frozen=True)
class RigidBottom:
    """A flat rigid bottom stands on corners of the outline's convex hull, whichever bear most.

    Attributes:
        weight: prior weight. (All shipped smooth fields together weigh 12.0.) With more, one push
            alone could take a heavy head for a body on corners.
        corner_std: standard deviation of log k at a corner; it is large because some corners bear
            next to nothing.
        rest_share: share of the load that rests on all other cells together.
        rest_std: standard deviation of log k of those.
    """

    weight: float = 0.05
    corner_std: float = 2.5
    rest_share: float = 0.02
    rest_std: float = 0.05

    @property
    def name(self) -> str:
        """Short name."""
        return "rigid bottom"

    @property
    def needs_pushes(self) -> bool:
        """False: the corners follow from the outline."""
        return False

    def propose(self, setting: Setting) -> list[LoadPrior]:
        """Proposes loads at the corners, where no cell has its center."""
        obj = setting.obj
        corners, p_corners = find_corners(obj)
        rest = np.setdiff1d(np.arange(obj.n), corners)
        mean = setting.z0.copy()
        mean[rest] += np.log(self.rest_share * len(corners) / max(len(rest), 1))
        variance = np.full(obj.n, self.corner_std**2)
        variance[rest] = self.rest_std**2
        p_BC = obj.p_BC.copy()
        p_BC[corners] = p_corners
        factor = calc_prior_factor(np.diag(variance), 1.0, setting.log_contact_friction_std)
        return [LoadPrior(mean=mean, factor=factor, weight=self.weight, p_BC=p_BC)]


@dataclass(frozen=True)
class Concentrated:
    """The load is gathered in the middle of the object, as in a bowl, or out at its rim.

    How far out the load lies is what turns an object most when it is pushed, and a smooth field has
    no single freedom for it. Here one number shifts the load inwards or outwards; within that,
    neighboring cells bear alike.

    Attributes:
        weight: prior weight. (All shipped smooth fields together weigh 12.0.)
        radius_std: sigma_r, standard deviation of how much log k changes over one standard
            deviation of the squared distance from the middle.
        amplitude: a_r, standard deviation of log k beside that.
        range_cells: correlation range beside that, cells.
    """

    weight: float = 1.0
    radius_std: float = 2.0
    amplitude: float = 0.3
    range_cells: float = RANGE_CELLS

    def __post_init__(self) -> None:
        """Raises IdentificationError: a number is not positive and finite."""
        _check_positive(self)

    @property
    def name(self) -> str:
        """Short name."""
        return "concentrated"

    @property
    def needs_pushes(self) -> bool:
        """False: the prior is the same for all pushes."""
        return False

    def propose(self, setting: Setting) -> list[LoadPrior]:
        """Proposes it; nothing where all cells are equally far from the middle."""
        obj = setting.obj
        q = calc_radius_mode(obj)
        if not q.any():
            return []
        # C(log k) = a_r² C + sigma_r² q q^T
        C = setting.calc_smooth_covariance(self.range_cells)
        covariance = self.amplitude**2 * C + self.radius_std**2 * np.outer(q, q)
        factor = calc_prior_factor(covariance, 1.0, setting.log_contact_friction_std)
        return [LoadPrior(mean=setting.z0, factor=factor, weight=self.weight, p_BC=obj.p_BC)]


@dataclass(frozen=True)
class TwoParts:
    """The object is of two parts, as of steel and of wood, that meet at a straight cut.

    Every cut that leaves both parts a share of the cells is scored to first order; the best few, no
    two alike, are proposed.

    Attributes:
        weight: prior weight of all cuts together. (All shipped smooth fields together weigh 12.0.)
        part_std: sigma_p, standard deviation of log k between the two parts.
        amplitude: a_p, standard deviation of log k within each part.
        range_cells: correlation range within each part, cells.
        max_cuts: how many cuts are proposed at most.
    """

    weight: float = 1.0
    part_std: float = 1.5
    amplitude: float = 0.3
    range_cells: float = RANGE_CELLS
    max_cuts: int = 3

    @property
    def name(self) -> str:
        """Short name."""
        return "two parts"

    @property
    def needs_pushes(self) -> bool:
        """True: the pushes choose the cuts."""
        return True

    def propose(self, setting: Setting) -> list[LoadPrior]:
        """Proposes the cuts that explain the pushes best to first order, the best one first."""
        return propose_modes(
            setting,
            find_cuts(setting.obj),
            weight=self.weight,
            mode_std=self.part_std,
            amplitude=self.amplitude,
            range_cells=self.range_cells,
            most=self.max_cuts,
        )


@dataclass(frozen=True)
class Ring:
    """The load lies in a ring about the middle, such as the foot of a bowl or the rim of a lid.

    Rings of many radii are scored to first order, as the cuts of `TwoParts` are; the best one is
    proposed.

    Attributes:
        weight: prior weight of all rings together. (All shipped smooth fields together weigh 12.0.)
        ring_std: sigma_o, standard deviation of how much log k changes over one standard deviation
            of the ring's mode.
        amplitude: a_o, standard deviation of log k beside that.
        range_cells: correlation range beside that, cells.
    """

    weight: float = 1.0
    ring_std: float = 2.0
    amplitude: float = 0.3
    range_cells: float = RANGE_CELLS

    def __post_init__(self) -> None:
        """Raises IdentificationError: a number is not positive and finite."""
        _check_positive(self)

    @property
    def name(self) -> str:
        """Short name."""
        return "ring"

    @property
    def needs_pushes(self) -> bool:
        """True: the pushes choose the radius."""
        return True

    def propose(self, setting: Setting) -> list[LoadPrior]:
        """Proposes the ring that explains the pushes best to first order."""
        return propose_modes(
            setting,
            find_rings(setting.obj),
            weight=self.weight,
            mode_std=self.ring_std,
            amplitude=self.amplitude,
            range_cells=self.range_cells,
            most=1,
        )


DEFAULT_HYPOTHESES: tuple[LoadHypothesis, ...] = (
    *(SmoothField(amplitude) for amplitude in AMPLITUDES),
    RigidBottom(),
    Concentrated(),
    TwoParts(),
    Ring(),
)
"""The hypotheses that `identify` weighs unless it is told others."""


def calc_smooth_covariance(obj: GridObject, range_cells: float = RANGE_CELLS) -> Array:
    """Calculates C of a smooth field: C^-1 ~ (L + kappa² I)², L the graph Laplacian of the cells.

    Args:
        obj: the object.
        range_cells: correlation range, cells.

    Returns:
        (n, n) covariance, of unit mean variance.
    """
    i, j = obj.adjacency.T
    L = np.zeros((obj.n, obj.n))
    np.add.at(L, (i, i), 1.0)
    np.add.at(L, (j, j), 1.0)
    L[i, j] = L[j, i] = -1.0
    root = np.linalg.inv(L + KAPPA_RANGE**2 / range_cells**2 * np.eye(obj.n))
    C = root @ root
    return C / np.diag(C).mean()


def calc_prior_factor(C: Array, amplitude: float, log_contact_friction_std: float) -> Array:
    """Cholesky factor (n+1, n+1) of blockdiag(a² C, sigma²), the prior covariance of z."""
    return np.asarray(
        block_diag(amplitude * np.linalg.cholesky(C), np.diag([log_contact_friction_std]))
    )


def propose_modes(
    setting: Setting,
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
        told = slice(-known, None)
        log_evidence -= calc_cut_evidence(modes, mode_std, within, residuals[told], J[told])
    left = np.ones(len(modes), dtype=bool)
    found: list[LoadPrior] = []
    while left.any() and len(found) < most:
        best = int(np.argmax(np.where(left, log_evidence, -np.inf)))
        alike = left & (_correlate(modes, modes[best]) > ALIKE)
        covariance = within[CELLS, CELLS] + mode_std**2 * np.outer(modes[best], modes[best])
        A = calc_prior_factor(covariance, 1.0, setting.log_contact_friction_std)
        # Where the linear pushes put z under this prior is where its fit begins.
        B = J @ A
        u = -B.T @ np.linalg.solve(np.eye(len(B)) + B @ B.T, residuals)
        # The evidence of this mode stands for the average over all modes, to which those like it
        # contribute as much less as they are less probable.
        share = float(np.exp(log_evidence[alike] - log_evidence[best]).sum() / len(modes))
        found.append(
            LoadPrior(
                mean=setting.z0,
                factor=A,
                weight=weight,
                p_BC=setting.obj.p_BC,
                evidence_share=share,
                start=setting.z0 + A @ u,
            )
        )
        left &= ~alike
    return found


def reduce_rows(pushes: LinearizedPushes) -> LinearizedPushes:
    """Says what pushes say in no more rows than there are unknowns, by a QR factorization.

    Every normal prior of z has the same evidence and the same optimum with both, but for a constant
    that all priors share.
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
    L = np.linalg.cholesky(np.eye(len(residuals)) + J @ within @ J.T)
    r = solve_triangular(L, residuals, lower=True)
    g = part_std * solve_triangular(L, J[:, CELLS] @ cuts.T, lower=True)
    size2 = 1 + (g * g).sum(axis=0)
    return np.asarray(0.5 * ((r @ g) ** 2 / size2 - np.log(size2)))


def _correlate(cuts: Array, cut: Array) -> Array:
    """Absolute correlation (cuts,) of each cut with one of them."""
    a = cuts - cuts.mean(axis=1, keepdims=True)
    b = cut - cut.mean()
    return np.asarray(np.abs(a @ b) / np.sqrt((a * a).sum(axis=1) * (b @ b)))
