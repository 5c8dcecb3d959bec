"""Masses and frictions of cells that agree with a friction that pushes showed, and with a weight.

Pushes say where an object is heavy and rough, up to a scale and to what friction hides; weighings
say the scale, and where the center of mass is (`absolute`). Together: the shares k_i of the
friction stay as the pushes showed them. The masses are the shares nearest to them, in relative
entropy, whose center is the center of mass,

    m_i = m a_i,    a_i ~ k_i exp(b·p_i),    sum a_i p_i = c

and the friction coefficients are what is left, mu_i = mu m k_i / m_i, so that their mean is mu
(`docs/theory/identification.md`, section 11).
"""

from dataclasses import replace

import numpy as np

from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.absolute.estimate import (
    CENTER_INDICES,
    LOG_FRICTION,
    LOG_MASS,
    WANTED_UNKNOWNS,
    AbsoluteEstimate,
)
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.statistics.posterior import Posterior
from gridpush_drake.objects.parameters import CellParameters

MAX_TILT_STEPS = 50
"""Largest number of Newton steps that tilt loads to a center."""

TILT_TOLERANCE = 1e-9
"""Largest distance of tilted loads' center from where it should be, relative to their extent."""

MAX_TILT = 30.0
"""Largest exponent by which tilting changes loads. A center at the object's very rim would need
more."""

FRICTION_SCATTER = 0.45
"""Standard deviation of how far a cell's log mu is from an even change along the object, as a
fraction of what the friction's bounds leave open of it. It is 0.42 to 0.47 for the nine shipped
objects, with hidden truths whose parts have frictions from 0.1 to 0.9, 0.2 to 0.6 and 0.3 to 0.4,
and loads, mass and center of mass that are known exactly (by object 0.33 to 0.69)."""

MAX_FRICTION = 1.5
"""Greatest friction coefficient that is given to a cell. What pushes and a center of mass far off
would ask for beyond it is not believed."""


def make_absolute_parameters(model: Model, fraction: Array, numbers: Array) -> CellParameters:
    """Makes the parameters of an object with given absolute numbers.

    Args:
        model: one object, with its parameters.
        fraction: (n,) k, positive, summing to one.
        numbers: (4,) log m, the center of mass, m, and log mu, as in `AbsoluteEstimate.mean`.
    """
    a = tilt_to_center(fraction, model.obj.p_BC, numbers[CENTER_INDICES])
    mass = float(np.exp(numbers[LOG_MASS]))
    friction = float(np.exp(numbers[LOG_FRICTION]))
    return replace(
        model.params, mass=mass * a, friction=np.minimum(friction * fraction / a, MAX_FRICTION)
    )


def draw_absolute_parameters(
    model: Model,
    posterior: Posterior,
    absolute: AbsoluteEstimate,
    count: int,
    seed: int = 0,
) -> list[CellParameters]:
    """Draws parameters that agree with pushes and weighings.

    Args:
        model: one object, with its parameters.
        posterior: the spread of the relative friction.
        absolute: mass, center of mass and mean friction.
        count: how many draws.
        seed: seed of the draws.

    Returns:
        The parameters. Where no forces of pushes were measured, their mean friction is the
        estimate's.
    """
    params = model.params
    fractions, contact_friction = posterior.draw(count, seed)
    rng = np.random.default_rng((seed, WANTED_UNKNOWNS))
    numbers = rng.multivariate_normal(absolute.mean, absolute.covariance, count)
    if not absolute.pushes:
        numbers[:, LOG_FRICTION] = np.log(params.mass @ params.friction / params.total_mass)
    return [
        replace(make_absolute_parameters(model, x, u), contact_friction=float(mu_c))
        for x, u, mu_c in zip(fractions, numbers, contact_friction, strict=True)
    ]


def calc_cell_stds(
    model: Model, fraction_std: Array, center_of_friction: Array, absolute: AbsoluteEstimate
) -> tuple[Array, Array]:
    """Calculates how well mass and friction of each cell are known, relative to themselves.

    With a_i = k_i exp(b·p_i - psi(b)), mass and friction are m a_i and mu exp(psi(b) - b·p_i), and

        d log m_i  = d log m + d log k_i + (p_i - c)·db + s_i
        d log mu_i = d log mu - (p_i - c)·db - s_i
        db = C^-1 (dc - dc_k),    C = sum a_i (p_i - c) (p_i - c)^T

    with c_k the center of friction, which moves as the k_i do, and s_i how far the friction is
    from such an even change, of which nothing is known (`FRICTION_SCATTER`). But for s_i it is the
    spread of the draws of `draw_absolute_parameters`.

    Args:
        model: one object, with its parameters.
        fraction_std: (n,) standard deviations of log k_i.
        center_of_friction: (2, 2) covariance of c_k, m².
        absolute: mass, center of mass and mean friction.

    Returns:
        (n,) standard deviations of log m_i, and (n,) of log mu_i.
    """
    obj = model.obj
    params = model.params
    a = params.mass / params.total_mass
    arm = obj.p_BC - a @ obj.p_BC
    # The pseudoinverse is for cells that all lie on a line.
    by_center = arm @ np.linalg.pinv((a[:, None] * arm).T @ arm)
    moved = absolute.center_covariance + center_of_friction
    apart = np.einsum("ia,ab,ib->i", by_center, moved, by_center)
    apart += (FRICTION_SCATTER * obj.prior.log_friction_std) ** 2
    mass = apart + fraction_std**2 + absolute.covariance[LOG_MASS, LOG_MASS]
    friction = apart + absolute.covariance[LOG_FRICTION, LOG_FRICTION]
    if absolute.pushes:
        friction -= 2 * by_center @ absolute.covariance[CENTER_INDICES, LOG_FRICTION]
    return np.sqrt(mass), np.sqrt(np.maximum(friction, 0.0))


def tilt_to_center(fraction: Array, p_BC: Array, center: Array) -> Array:
    """Tilts loads so that their center is at a place: a_i ~ x_i exp(b·p_i), sum a_i p_i = c.

    These are the loads nearest to x, in relative entropy, with that center. b minimizes the convex
    log sum x_i exp(b·(p_i - c)), and is found by Newton's method.

    Args:
        fraction: (n,) x, positive, summing to one.
        p_BC: (n, 2) where the loads are, m.
        center: (2,) where their center should be, m.

    Returns:
        (n,) a, summing to one. If the place is beyond the loads, their center comes as near to it
        as `MAX_TILT` lets it.
    """
    size = float(np.abs(p_BC - p_BC.mean(axis=0)).max()) or 1.0
    arm = (p_BC - center) / size
    b = np.zeros(2)

    def tilt(b: Array) -> tuple[float, Array]:
        """The convex function at b, and the loads (n,)."""
        exponent = arm @ b
        highest = float(exponent.max())
        weight = fraction * np.exp(exponent - highest)
        total = float(weight.sum())
        return highest + float(np.log(total)), weight / total

    value, a = tilt(b)
    for _ in range(MAX_TILT_STEPS):
        off = a @ arm
        if np.abs(off).max() < TILT_TOLERANCE:
            break
        spread = (a[:, None] * arm).T @ arm - np.outer(off, off)
        step = -np.linalg.lstsq(spread, off, rcond=None)[0]
        step *= min(1.0, MAX_TILT / max(float(np.abs(arm @ step).max()), MAX_TILT))
        # A step that does not make the function smaller is halved.
        tried = tilt(b + step)
        while tried[0] > value and np.abs(step).max() > TILT_TOLERANCE:
            step = step / 2
            tried = tilt(b + step)
        if np.abs(arm @ (b + step)).max() > MAX_TILT:
            break
        b = b + step
        value, a = tried
    return np.asarray(a)
