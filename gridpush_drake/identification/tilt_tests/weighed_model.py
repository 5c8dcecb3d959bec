"""A learned model whose object was weighed: absolute masses, frictions and center of mass.

`estimate_masses` takes what pushes said and what weighings say, and returns the model with both.
How the absolute numbers are estimated is in `absolute`, and how masses and frictions of the cells
follow from them in `absolute_masses`.
"""

from dataclasses import replace

import numpy as np
from shapely import Point
from threadpoolctl import threadpool_limits

from gridpush_drake.errors import IdentificationError
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.absolute.estimate import (
    CENTER_INDICES,
    LOG_FRICTION,
    AbsoluteEstimate,
    AbsolutePrior,
    MassProblem,
    PoseNoise,
)
from gridpush_drake.identification.absolute.masses import (
    calc_cell_stds,
    make_absolute_parameters,
    tilt_to_center,
)
from gridpush_drake.identification.identifiability import calc_identifiability
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.result import (
    Identification,
    IdentificationStatus,
    calc_center_of_friction,
    calc_center_of_mass,
)
from gridpush_drake.identification.sentences import describe_center_outside
from gridpush_drake.identification.statistics.friction_gradient import (
    HeldFriction,
    calc_gradient_std,
)
from gridpush_drake.identification.tilt_tests.outliers import estimate_absolute
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.pushes.plausibility import check_plausible_mass_tests
from gridpush_drake.pushes.weighings import MassTestLog

POSTERIOR_DRAWS = 64
"""Number of draws from the posterior by which the spread of the radius of gyration is computed."""

WHOLE_OBJECT = 1e-6
"""Ridge on the covariance of the center of mass, as a fraction of the squared radius of gyration,
so that the center of an object that is a thin line has a covariance, too."""


# As in `identify`: the number of threads of BLAS decides the order of sums, and so the last bits.
@threadpool_limits.wrap(limits=1, user_api="blas")
def estimate_masses(
    found: Identification,
    log: MassTestLog,
    *,
    prior: AbsolutePrior | None = None,
    noise: PoseNoise | None = None,
    seed: int = 0,
) -> Identification:
    """Adds weighings to a learned model, in the place of those that it has.

    Args:
        found: what pushes said, and their forces where they were measured.
        log: the weighings.
        prior: what is held of mass and friction beforehand.
        noise: of the poses and places of the weighings.
        seed: of the draws by which the spread of the inertia is computed.

    Returns:
        The model with absolute masses and frictions, and their estimate in `absolute`. Where the
        observations contradict each other, masses and frictions stay as they were, and only the
        estimate, which says so, is added.

    Its status is "explains_little" where the weighings put the center of mass outside the object:
    then something is wrong with them, and the model should not be used.

    Warns:
        PushLogWarning: the weighings may be true, but hardly are.

    Raises:
        IdentificationError: there is no weighing, or its equations cannot be solved.
        PushLogError: the weighings cannot be true of the object, see `pushes.plausibility`.
    """
    if not len(log):
        raise IdentificationError("weighings: there are none; expected at least one")
    check_plausible_mass_tests(found.obj, log)
    found = found.unweighed
    estimate = calc_estimate(found, log, prior=prior, noise=noise, seed=seed)
    return add_estimate(found, estimate, log.source)


def calc_estimate(
    found: Identification,
    log: MassTestLog,
    *,
    prior: AbsolutePrior | None = None,
    noise: PoseNoise | None = None,
    seed: int = 0,
) -> AbsoluteEstimate:
    """Calculates mass, center of mass, friction and gyration; see `estimate_masses`."""
    center, covariance = calc_center_prior(found)
    problem = MassProblem(
        log=log,
        center=center,
        center_covariance=covariance,
        force=found.force,
        prior=prior or AbsolutePrior(),
        noise=noise or PoseNoise(),
        gravity=found.physics.gravity,
        outline_center=_expect_center(found),
    )
    try:
        return _add_gyration(found, estimate_absolute(problem), seed)
    except np.linalg.LinAlgError as error:
        raise IdentificationError(
            f"{log.source or 'weighings'}: no mass and center of mass are found that explain them; "
            "are force and force_std in N, and torque_x, torque_y and torque_std in N m?"
        ) from error


def add_estimate(
    found: Identification, estimate: AbsoluteEstimate, source: str = ""
) -> Identification:
    """Adds to a learned model what weighings say; see `estimate_masses`.

    Args:
        found: the model, of the pushes alone.
        estimate: what the weighings say.
        source: what names the weighings in messages.
    """
    if estimate.contradictory:
        weighed = _attach_estimate(found, estimate)
    else:
        # As much as weighings leave open of the center of mass, they leave open of the gradient of
        # the friction.
        left = float(np.trace(estimate.center_covariance) / np.trace(calc_center_prior(found)[1]))
        gradient = calc_gradient_std(found.obj.prior) * min(1.0, float(np.sqrt(left)))
        noise = replace(found.noise, friction_gradient=gradient)
        weighed = apply_absolute(replace(found, noise=noise), estimate)
    return _note_center_outside(replace(weighed, pushed=found), source or "weighings")


def _note_center_outside(found: Identification, source: str) -> Identification:
    """Marks a model "explains_little" whose center of mass is outside its object, and says so.

    The center of mass lies within the outline's convex hull, whatever the masses are.

    Args:
        found: the model, with its absolute numbers.
        source: what names the weighings.
    """
    assert found.absolute is not None
    center = Point(found.absolute.center_of_mass)
    distance = float(found.obj.outline.convex_hull.distance(center))
    if distance == 0:
        return found
    message = describe_center_outside(found, distance, source)
    if found.status == IdentificationStatus.EXPLAINS_LITTLE:
        message = f"{found.message} {message}"
    return replace(found, status=IdentificationStatus.EXPLAINS_LITTLE, message=message)


def hold_friction(found: Identification) -> HeldFriction:
    """Returns the frictions of a weighed model, to be held when pushes are learned from again."""
    return HeldFriction(found.params.friction, found.noise.friction_gradient)


def calc_center_prior(found: Identification) -> tuple[Array, Array]:
    """Calculates where pushes say that the center of mass is, and how surely.

    It is the center of friction, moved by what friction may change along the object: with log mu_i
    = b·(p_i - c), b ~ N(0, s²/r² I), and M = sum x_i (p_i - c) (p_i - c)^T, by -M b. A center of
    mass that was told is where it was told. How large s is, `friction_gradient` says.

    Args:
        found: what was learned.

    Returns:
        p_BBcm (2,), m, body frame, and its covariance (2, 2), m².
    """
    obj = found.obj
    if obj.prior.center_of_mass is None:
        center, covariance = calc_center_of_friction(found)
        s = calc_gradient_std(obj.prior)
        fraction = found.posterior.calc_fraction()
        arm = obj.p_BC - fraction @ obj.p_BC
        M = (fraction[:, None] * arm).T @ arm
        covariance = covariance + s**2 / max(float(np.trace(M)), np.finfo(float).tiny) * M @ M
    else:
        center, covariance = calc_center_of_mass(found)
    return center, covariance + _make_ridge(obj)


def _expect_center(found: Identification) -> tuple[Array, Array] | None:
    """Where the center of mass is expected by the outline alone.

    In its middle, give or take the outline's own spread; None where it was told.

    Returns:
        p_BBcm (2,), m, body frame, and its covariance (2, 2), m².
    """
    obj = found.obj
    if obj.prior.center_of_mass is not None:
        return None
    arm = obj.p_BC - obj.p_BC.mean(axis=0)
    return obj.p_BC.mean(axis=0), arm.T @ arm / obj.n + _make_ridge(obj)


def _make_ridge(obj: GridObject) -> Array:
    """The ridge (2, 2), m², on a covariance of the center of mass; see WHOLE_OBJECT."""
    return np.asarray(WHOLE_OBJECT * obj.radius_of_gyration**2 * np.eye(2))


def believe_before(found: Identification) -> AbsoluteEstimate:
    """Says what is held of mass, center of mass and friction before the first press.

    If the forces of pushes were measured, mass and friction are tied to one another: the mass is
    then known better than its prior, since friction is.
    """
    prior = AbsolutePrior()
    center, center_covariance = calc_center_prior(found)
    if found.force is not None:
        problem = MassProblem(
            log=MassTestLog(),
            center=center,
            center_covariance=center_covariance,
            force=found.force,
            prior=prior,
            gravity=found.physics.gravity,
        )
        return estimate_absolute(problem)
    log_mass, mass_std = prior.log_mass
    log_friction, friction_std = prior.log_friction
    covariance = np.diag([mass_std**2, 0.0, 0.0, friction_std**2])
    covariance[CENTER_INDICES, CENTER_INDICES] = center_covariance
    return AbsoluteEstimate(mean=np.array([log_mass, *center, log_friction]), covariance=covariance)


def apply_absolute(found: Identification, estimate: AbsoluteEstimate) -> Identification:
    """Gives a model the absolute numbers of an estimate.

    Args:
        found: the model; its relative friction stays as it is.
        estimate: mass, center of mass and mean friction.

    Returns:
        The model, with masses, frictions, standard deviations and statements of the estimate.
    """
    obj = found.obj
    fraction = found.params.relative_friction()
    # Without measured forces, the mean friction stays as it was supposed.
    numbers = estimate.mean.copy()
    if not estimate.pushes:
        supposed = float(found.params.mass @ found.params.friction) / found.params.total_mass
        numbers[LOG_FRICTION] = np.log(supposed)
    params = make_absolute_parameters(Model(obj, found.params), fraction, numbers)
    fraction_std = found.std.mass / found.params.mass
    _, center_of_friction = calc_center_of_friction(found)
    mass, friction = calc_cell_stds(Model(obj, params), fraction_std, center_of_friction, estimate)
    std = CellParameters(
        mass=params.mass * mass,
        friction=params.friction * friction,
        contact_friction=found.std.contact_friction,
    )
    return _attach_estimate(replace(found, parameters=(params,), std=std), estimate)


def _attach_estimate(found: Identification, estimate: AbsoluteEstimate) -> Identification:
    """Adds an estimate and its statements to a model whose masses and frictions stay."""
    return replace(
        found,
        absolute=estimate,
        identifiability=calc_identifiability(found, found.posterior, found.force, estimate),
    )


def _add_gyration(found: Identification, estimate: AbsoluteEstimate, seed: int) -> AbsoluteEstimate:
    """Adds the radius of gyration to an estimate: of the map of masses, and of draws of it."""
    obj = found.obj
    rng = np.random.default_rng((seed, POSTERIOR_DRAWS))
    fractions = found.posterior.draw(POSTERIOR_DRAWS, seed)[0]
    centers = rng.multivariate_normal(
        estimate.center_of_mass, estimate.center_covariance, len(fractions)
    )
    best = _calc_gyration(obj, found.params.relative_friction(), estimate.center_of_mass)
    drawn = [_calc_gyration(obj, x, c) for x, c in zip(fractions, centers, strict=True)]
    return replace(estimate, gyration=best, gyration_std=float(np.std(drawn)))


def _calc_gyration(obj: GridObject, fraction: Array, center: Array) -> float:
    """Radius of gyration, m, of the masses with these shares (n,) of friction and this center."""
    a = tilt_to_center(fraction, obj.p_BC, center)
    arm = obj.p_BC - a @ obj.p_BC
    # Each cell is a square plate, with s²/6 about its own center.
    return float(np.sqrt(a @ (arm**2).sum(axis=1) + obj.cell_size**2 / 6))
