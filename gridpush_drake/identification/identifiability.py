"""What pushes can tell, and what they cannot (`docs/theory/identification.md`, section 2).

Slow pushes observed by their poses see only the relative support friction k_i = mu_i m_i / sum(mu
m), and of it only the combinations that the pushes excited. Mass and friction by themselves need a
weight, a measured force, a fast push, or bounds: with mu_min <= mu_i <= mu_max every mass
distribution k_i/mu_max <= m_i/c <= k_i/mu_min agrees with the data.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog

from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.absolute.estimate import (
    INTERVAL_SIGMAS,
    AbsoluteEstimate,
)
from gridpush_drake.identification.absolute.force_scale import ForceScale
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.statements import list_statements
from gridpush_drake.identification.statistics.posterior import (
    CELL_ENTRIES,
    LEARNED_FRACTION,
    Posterior,
    compare_covariances,
)
from gridpush_drake.notebook import make_page, make_table
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.units import MM_PER_M

RANK_TOLERANCE = 1e-9
"""Relative length below which a direction that is left over counts as none."""


@dataclass(frozen=True, eq=False)
class Identifiability:
    """What the data determine.

    Attributes:
        relative_friction: (n,) k, summing to one.
        relative_friction_std: (n,) its standard deviation.
        center_of_friction: (2,) sum k_i p_BC_i, m, body frame.
        center_of_friction_covariance: (2, 2) m².
        learned_directions: how many independent combinations of the cells' log-friction the pushes
            determined.
        null_space: (n - learned_directions, n) orthonormal basis of those they did not; its first
            row is the common scale, which no slow push shows.
        learned_share: (n,) fraction of each cell's prior variance that the pushes took away, 0 to
            1.
        mass_min: (n,) kg, the least mass each cell may have, given the friction bounds and the
            total mass.
        mass_max: (n,) kg, the greatest mass each cell may have.
        center_of_mass_box: (2, 2) rows min and max of the centers of mass that agree with k, taken
            for exact, and the bounds, m.
        free_box: (2, 2) the same box without what forces and weighings say, m.
        obj: the object.
        force: what measured forces say; None where there are none.
        absolute: what weighings say; None of an object that was not weighed.
    """

    relative_friction: Array
    relative_friction_std: Array
    center_of_friction: Array
    center_of_friction_covariance: Array
    learned_directions: int
    null_space: Array
    learned_share: Array
    mass_min: Array
    mass_max: Array
    center_of_mass_box: Array
    free_box: Array
    obj: GridObject
    force: ForceScale | None = None
    absolute: AbsoluteEstimate | None = None

    @property
    def statements(self) -> tuple[str, ...]:
        """All this in sentences, for a report."""
        variance = np.diag(self.center_of_friction_covariance)
        return list_statements(
            self.obj,
            learned=self.learned_directions,
            learned_share=self.learned_share,
            center_std=np.sqrt(np.maximum(variance, 0.0)),
            free_box=self.free_box,
            box=self.center_of_mass_box,
            force=self.force,
            absolute=self.absolute,
        )

    def __repr__(self) -> str:
        """How much is known, in a line."""
        x, y = self.center_of_friction * MM_PER_M
        return (
            f"Identifiability: {self.learned_directions} of {len(self.relative_friction)} "
            "combinations of the cells' friction are known, "
            f"center of friction at ({x:.1f}, {y:.1f}) mm"
        )

    def _repr_html_(self) -> str:
        """What the pushes say and what they cannot, statement by statement."""
        return make_page(
            repr(self), make_table(("what the pushes say",), [[each] for each in self.statements])
        )


def calc_identifiability(
    model: Model,
    posterior: Posterior,
    force: ForceScale | None = None,
    absolute: AbsoluteEstimate | None = None,
) -> Identifiability:
    """Says what a posterior determines.

    Args:
        model: one object, with its parameters.
        posterior: what is known of the logarithms of the cells' friction.
        force: the scale that measured forces give; None where there are none.
        absolute: what weighings say; None of an object that was not weighed.

    Returns:
        The report.
    """
    obj = model.obj
    params = model.params
    fraction = posterior.calc_fraction()
    fraction_covariance = posterior.calc_fraction_covariance()

    # What the pushes showed of the friction: which combinations, and of each cell by itself.
    prior = posterior.prior_covariance[CELL_ENTRIES, CELL_ENTRIES]
    after = posterior.covariance[CELL_ENTRIES, CELL_ENTRIES]
    null_space = _calc_null_space(prior, after)
    learned_share = np.clip(1 - np.diag(after) / np.diag(prior), 0.0, 1.0)

    # c = sum_i x_i p_i is linear in the shares.
    center = fraction @ obj.p_BC
    center_covariance = obj.p_BC.T @ fraction_covariance @ obj.p_BC

    # Mass by itself is known only within what the friction bounds leave. Measured forces narrow
    # that, if they agree with the mass that was told.
    mass_min, mass_max = _calc_mass_bounds(fraction, params.total_mass, obj, force)
    wide = calc_center_of_mass_box(fraction, obj)
    box = wide
    mean_friction = None if force is None else force.calc_mean_friction_bounds(obj)
    if mean_friction is not None:
        box = _calc_box_of_known_scale(fraction, obj, *mean_friction)

    if absolute is not None and not absolute.contradictory:
        # The object's mass is known now, whatever the forces bounded it to.
        mass_min, mass_max = _calc_mass_bounds(fraction, params.total_mass, obj, None)
        box = _cut_box(wide, absolute)
    return Identifiability(
        relative_friction=fraction,
        relative_friction_std=np.sqrt(np.maximum(np.diag(fraction_covariance), 0.0)),
        center_of_friction=center,
        center_of_friction_covariance=center_covariance,
        learned_directions=obj.n - len(null_space),
        null_space=null_space,
        learned_share=learned_share,
        mass_min=mass_min,
        mass_max=mass_max,
        center_of_mass_box=box,
        free_box=wide,
        obj=obj,
        force=force,
        absolute=absolute,
    )


def calc_farthest_center(p: Array, mass_min: Array, mass_max: Array) -> Array:
    """Calculates how far the center of mass can be along an axis, each mass within its bounds.

    That is the greatest sum m_i p_i / sum m_i, mass_min <= m <= mass_max: a linear-fractional
    program. Every cell on the far side of a cut is as heavy, and on the near side as light, as can
    be. The cut runs through the optimum itself, so that trying every cell's coordinate finds it.

    Args:
        p: (n,) the cells' coordinates along the axis, m.
        mass_min: (S, n) the least masses of S sets, up to a scale.
        mass_max: (S, n) the greatest.

    Returns:
        (S,) m.
    """
    order = np.argsort(p)
    p = p[order]
    light = mass_min[:, order]
    heavy = mass_max[:, order]
    # Column j is the cut before cell j: cells below it are light, the others heavy.
    mass = _sum_up(light) + _sum_down(heavy)
    moment = _sum_up(light * p) + _sum_down(heavy * p)
    return np.asarray((moment / mass).max(axis=1))


def calc_center_of_mass_box(fraction: Array, obj: GridObject) -> Array:
    """Bounds of the center of mass over all m_i in [k_i/mu_max, k_i/mu_min], up to a common scale.

    Args:
        fraction: (n,) k, summing to one.
        obj: the object, with its friction bounds.

    Returns:
        (2, 2) rows least and greatest, columns x and y, m, body frame.
    """
    light = fraction[None] / obj.prior.friction_max
    heavy = fraction[None] / obj.prior.friction_min
    # The least is the farthest on the mirrored axis.
    farthest = [
        [sign * calc_farthest_center(sign * p, light, heavy)[0] for p in obj.p_BC.T]
        for sign in (-1.0, 1.0)
    ]
    return np.array(farthest)


def _sum_up(values: Array) -> Array:
    """Sums (S, n+1) of the first 0, 1, .., n values of each row (S, n)."""
    return np.concatenate([np.zeros((len(values), 1)), np.cumsum(values, axis=1)], axis=1)


def _sum_down(values: Array) -> Array:
    """Sums (S, n+1) of the last n, n-1, .., 0 values of each row (S, n)."""
    return _sum_up(values[:, ::-1])[:, ::-1]


def _calc_box_of_known_scale(
    fraction: Array, obj: GridObject, lowest: float, highest: float
) -> Array:
    """Calculates the box of centers of mass where the mean friction coefficient is known.

    Each side is a linear program in a_i = m_i / M and the mean coefficient t (section 10):

        max a·p,    sum a_i = 1,    x_i t / mu_max <= a_i <= x_i t / mu_min

    Args:
        fraction: (n,) x, summing to one.
        obj: the object, with its friction bounds and its mass M.
        lowest: the least t.
        highest: the greatest t.

    Returns:
        (2, 2) rows least and greatest, columns x and y, m, body frame.
    """
    # The unknowns are (a, t). First a_i - x_i t / mu_min <= 0, then x_i t / mu_max - a_i <= 0.
    n = obj.n
    identity = np.eye(n)
    heaviest = [identity, -(fraction / obj.prior.friction_min)[:, None]]
    lightest = [-identity, (fraction / obj.prior.friction_max)[:, None]]
    A = np.block([heaviest, lightest])
    bounds = [(0.0, 1.0)] * n + [(lowest, highest)]
    box = np.empty((2, 2))
    for axis, p in enumerate(obj.p_BC.T):
        for row, sign in enumerate((1.0, -1.0)):
            found = linprog(
                np.append(sign * p, 0.0),
                A_ub=A,
                b_ub=np.zeros(2 * n),
                A_eq=[np.append(np.ones(n), 0.0)],
                b_eq=[1.0],
                bounds=bounds,
            )
            box[row, axis] = sign * found.fun
    return box


def _calc_mass_bounds(
    fraction: Array, total_mass: float, obj: GridObject, force: ForceScale | None
) -> tuple[Array, Array]:
    """Calculates each cell's least and greatest mass, kg.

    A cell is lightest if its friction coefficient is the greatest it may be and that of all others
    the least, and heaviest the other way round. With measured forces, its friction by itself bounds
    its mass, too; where the object's mass is not known, that alone does.
    """
    low = obj.prior.friction_min
    high = obj.prior.friction_max
    unknown = obj.prior.total_mass is None
    # Forces that contradict the mass told are not used.
    if force is not None and (unknown or force.calc_mean_friction_bounds(obj) is not None):
        # Section 10: as for the whole object, with x_i K in place of K.
        lightest, heaviest = force.calc_mass_bounds(obj)
        if unknown:
            return fraction * lightest, fraction * heaviest
        least, most = _calc_mass_bounds(fraction, total_mass, obj, None)
        return np.maximum(least, fraction * lightest), np.minimum(most, fraction * heaviest)
    # Section 2: m_i is proportional to x_i / mu_i, and all masses add up to the total.
    least = (fraction / high) / (fraction / high + (1 - fraction) / low)
    most = (fraction / low) / (fraction / low + (1 - fraction) / high)
    return total_mass * least, total_mass * most


def _calc_null_space(prior: Array, after: Array) -> Array:
    """Finds the directions of log k that the pushes left open.

    Args:
        prior: (n, n) covariance of log k before the pushes.
        after: (n, n) covariance after them.

    Returns:
        An orthonormal basis (m, n) of the directions whose prior variance the pushes did not reduce
        by LEARNED_FRACTION, the common scale first.
    """
    n = len(prior)
    ratio, directions, root, _ = compare_covariances(prior, after)
    unknown = (root @ directions[:, ratio > 1 - LEARNED_FRACTION]).T

    # QR keeps the first row, and makes the others orthogonal to it. What is nothing but the
    # common scale is left with next to no length, and is dropped.
    scale = np.full((1, n), 1 / np.sqrt(n))
    basis, triangle = np.linalg.qr(np.concatenate([scale, unknown]).T)
    keep = np.abs(np.diag(triangle)) > RANK_TOLERANCE * np.abs(triangle).max()

    # The sign of a direction means nothing: the first cell's is positive.
    signs = np.where(basis[:1, keep] < 0, -1.0, 1.0)
    return (basis[:, keep] * signs).T


def _cut_box(box: Array, absolute: AbsoluteEstimate) -> Array:
    """Cuts a box (2, 2) of centers of mass down to where weighings say that the center is.

    If both have no point in common, the weighings are believed.
    """
    reach = INTERVAL_SIGMAS * absolute.center_std
    known = np.array([absolute.center_of_mass - reach, absolute.center_of_mass + reach])
    both = np.array([np.maximum(box[0], known[0]), np.minimum(box[1], known[1])])
    return both if (both[0] < both[1]).all() else known
