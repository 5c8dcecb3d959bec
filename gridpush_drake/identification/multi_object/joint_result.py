"""What was learned of several objects together: `JointIdentification`, and a model of each."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.geometry.se2 import Array, IntArray
from gridpush_drake.identification.absolute.force_scale import ForceScale
from gridpush_drake.identification.identifiability import calc_identifiability
from gridpush_drake.identification.model import Model, check_draws
from gridpush_drake.identification.result import (
    FitStart,
    HypothesisEvidence,
    Identification,
    IdentificationStatus,
)
from gridpush_drake.identification.sentences import describe_part
from gridpush_drake.identification.statistics.noise import NoiseModel, NoiseScale
from gridpush_drake.identification.statistics.posterior import Posterior
from gridpush_drake.objects.parameters import CellParameters

METHOD = "scene"
"""Name of the method in the models."""

LITTLE = 0.5
"""Fraction of the pushes that the model does not explain from which on it explains little."""

UNEXPLAINED = 4.0
"""Root mean square of a push's residuals, in units of the noise, beyond which the model does not
explain the push."""

SHOWN = 0.8
"""Fraction of the standard deviation beforehand that is left of what pushes did show, at most."""

MAX_LOG_FRICTION = 1.0
"""Farthest that the logarithm of a drawn contact friction is from the best model's."""


@dataclass(frozen=True, eq=False, kw_only=True)
class JointIdentification(Model):
    """A model of several objects that were learned together, and how far it can be trusted.

    Attributes:
        objects: the N objects.
        parameters: (N,) the masses and frictions that fit best.
        physics: physics of the simulations.
        pair_friction: (N, N) the frictions of the objects against each other that fit best.
        z: (Z,) the unknowns that fit best, see the module's description.
        covariance: (Z, Z) posterior covariance of z.
        prior_covariance: (Z, Z) covariance of z before the pushes.
        amplitude: standard deviation of log k of the smooth fields that were taken.
        evidence: logarithm of the evidence of each smooth field, by increasing amplitude.
        noise: standard deviations of poses that were assumed, m, m and rad.
        noise_scale: root mean square of the residuals, in units of that noise, in which poses that
            the model cannot explain count for little.
        push_scales: (P,) root mean square of each push's residuals, in units of that noise.
        simulations: number of pushes that were simulated.
        push_names: names of the pushes.
        moves: (N,) number of pushes that moved the object by more than the noise.
        errors_before: (P, N) cell errors at the ends of the pushes with even objects, m.
        errors: (P, N) those with what was learned, m.
        forces: (N,) what measured forces say of each object's friction with the table; empty where
            none were learned from.
        hypotheses: (N,) evidence and weight of each hypothesis of an object's loads that was
            fitted, with those of the smooth fields that were taken; empty where none was.
    """

    z: Array
    covariance: Array
    prior_covariance: Array
    amplitude: float
    evidence: Array
    noise: tuple[float, float, float]
    noise_scale: float
    push_scales: Array
    simulations: int
    push_names: tuple[str, ...]
    moves: IntArray
    errors_before: Array
    errors: Array
    forces: tuple[ForceScale, ...] = ()
    hypotheses: tuple[tuple[HypothesisEvidence, ...], ...] = ()

    @property
    def fit_starts(self) -> tuple[FitStart, ...]:
        """The place where a fit to more pushes may begin."""
        return (FitStart(self.z, NoiseScale()),)

    @property
    def moved(self) -> NDArray[np.bool_]:
        """Whether a push moved the object by more than the noise, (N,)."""
        return np.asarray(self.moves > 0)

    @property
    def unexplained(self) -> tuple[str, ...]:
        """Names of the pushes that the model does not explain: what was learned hangs on others.

        A pose may have jumped, somebody may have moved an object, or the fit found no loads with
        which an object is hit, or missed, as it was.
        """
        far = self.push_scales > UNEXPLAINED
        return tuple(name for name, off in zip(self.push_names, far, strict=True) if off)

    def list_unknowns(self, body: int) -> IntArray:
        """Lists the places in z of an object's cells, and of its friction with the pusher."""
        cells = sum(obj.n for obj in self.objects)
        return np.append(self._cells(body), cells + body)

    def calc_center(self, body: int) -> tuple[Array, Array]:
        """Calculates where an object's load is centered.

        Args:
            body: number of the object.

        Returns:
            The center of friction (2,), body frame, m, and its posterior covariance (2, 2), m².
        """
        obj = self.objects[body]
        params = self.parameters[body]
        fraction = params.relative_friction()
        center = fraction @ obj.p_BC
        # dc = sum of share_i (p_i - c) dlog k_i
        J = (fraction[:, None] * (obj.p_BC - center)).T
        cells = self._cells(body)
        return center, J @ self.covariance[np.ix_(cells, cells)] @ J.T

    def calc_load_ratio(self, body: int, other: int) -> tuple[float, float]:
        """Calculates how heavy one object is beside another, with the friction of both.

        Args:
            body: number of the object.
            other: number of the other one.

        Returns:
            The logarithm of the ratio of their whole friction with the table, and its posterior
            standard deviation.
        """
        loads = []
        for b in (body, other):
            params = self.parameters[b]
            loads.append(float(params.mass @ params.friction))
        return float(np.log(loads[0] / loads[1])), self._calc_ratio_std(
            body, other, self.covariance
        )

    def shows_load_ratio(self, body: int, other: int) -> bool:
        """Says whether the pushes showed how heavy one object is beside another.

        They do not where none moved both, or a third one that both moved in other pushes.
        """
        before = self._calc_ratio_std(body, other, self.prior_covariance)
        return self._calc_ratio_std(body, other, self.covariance) < SHOWN * before

    def shows_pair_friction(self) -> NDArray[np.bool_]:
        """Says of which pairs (P,) the pushes show the friction on each other."""
        pairs = len(self) * (len(self) - 1) // 2
        before = np.sqrt(np.diag(self.prior_covariance)[len(self.z) - pairs :])
        return np.asarray(self.calc_pair_friction_std() < SHOWN * before)

    def calc_pair_friction_std(self) -> Array:
        """Calculates the posterior standard deviations (P,) of the logarithms of pair frictions."""
        pairs = len(self) * (len(self) - 1) // 2
        variances = np.diag(self.covariance)
        return np.sqrt(variances[len(variances) - pairs :])

    def _calc_ratio_std(self, body: int, other: int, covariance: Array) -> float:
        """Calculates the standard deviation of the logarithm of two objects' ratio of loads."""
        J = np.zeros(len(covariance))
        for b, sign in ((body, 1.0), (other, -1.0)):
            J[self._cells(b)] += sign * self.parameters[b].relative_friction()
        return float(np.sqrt(J @ covariance @ J))

    def _cells(self, body: int) -> IntArray:
        """The places in z of an object's cells."""
        first = sum(obj.n for obj in self.objects[:body])
        return np.arange(first, first + self.objects[body].n)

    def draws(self, count: int, seed: int = 0) -> "list[Model]":  # type: ignore[override]
        """Draws models that may be true as well, from the posterior of z.

        Args:
            count: how many.
            seed: seed of the draws.

        Raises:
            IdentificationError: the count or the seed is negative.
        """
        check_draws(count, seed)
        n = len(self)
        # a root of the covariance, which may be singular up to round-off
        values, vectors = np.linalg.eigh(self.covariance)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        rng = np.random.default_rng(seed)
        sizes = [obj.n for obj in self.objects]
        pairs = np.triu_indices(n, 1)
        models = []
        for _ in range(count):
            change = root @ rng.standard_normal(len(root))
            *logs, finger, pair = np.split(change, np.cumsum([*sizes, n]))
            finger = np.clip(finger, -MAX_LOG_FRICTION, MAX_LOG_FRICTION)
            pair = np.clip(pair, -MAX_LOG_FRICTION, MAX_LOG_FRICTION)
            drawn = [
                replace(
                    each,
                    mass=each.mass * np.exp(log),
                    contact_friction=float(each.contact_friction * np.exp(mu)),
                )
                for each, log, mu in zip(self.parameters, logs, finger, strict=True)
            ]
            friction = np.zeros((n, n))
            friction[pairs] = self.pair_friction[pairs] * np.exp(pair)
            models.append(Model(self.objects, drawn, self.physics, friction + friction.T))
        return models

    @cached_property
    def parts(self) -> tuple[Identification, ...]:
        """(N,) a model of each object: its part of the common posterior.

        Each can be used as any other: to predict, to plan, to be written to a file. Their masses
        have the ratios that were learned; how heavy all are together only forces tell. What
        objects have in common, such as how rough they are to each other, stands here alone.
        """
        return tuple(_make_part(self, b) for b in range(len(self)))


def _make_part(found: JointIdentification, body: int) -> Identification:
    obj = found.objects[body]
    params = found.parameters[body]
    # the object's own unknowns: its cells, and its friction with the pusher
    places = found.list_unknowns(body)
    block = np.ix_(places, places)
    posterior = Posterior(
        mean=found.z[places],
        covariance=found.covariance[block],
        prior_covariance=found.prior_covariance[block],
    )
    fraction = posterior.calc_fraction()
    relative_std = (
        np.sqrt(np.maximum(np.diag(posterior.calc_fraction_covariance()), 0.0)) / fraction
    )
    std = CellParameters(
        mass=np.maximum(params.mass * relative_std, np.finfo(float).tiny),
        friction=np.full(obj.n, obj.prior.friction_std),
        contact_friction=float(params.contact_friction * np.sqrt(posterior.covariance[-1, -1])),
    )
    force = found.forces[body] if found.forces else None
    errors = float(found.errors[:, body].mean())
    even_errors = float(found.errors_before[:, body].mean())
    status = IdentificationStatus.LEARNED
    if not found.moved[body]:
        status = IdentificationStatus.PRIOR_KEPT
    elif len(found.unexplained) >= LITTLE * len(found.push_names):
        status = IdentificationStatus.EXPLAINS_LITTLE
    elif errors > even_errors:
        status = IdentificationStatus.PRIOR_KEPT
    message = describe_part(
        status,
        moved=bool(found.moved[body]),
        others=len(found) - 1,
        pushes=len(found.push_names),
        errors=(errors, even_errors),
        unexplained=found.unexplained,
    )
    return Identification(
        objects=(obj,),
        parameters=(params,),
        std=std,
        posterior=posterior,
        identifiability=calc_identifiability(Model(obj, params), posterior, force),
        method=METHOD,
        physics=found.physics,
        status=status,
        message=message,
        history=(),
        simulations=found.simulations,
        noise_std=found.noise_scale * found.noise[0],
        load_shift_std=0.0,
        seed=0,
        push_names=found.push_names,
        noise=NoiseModel(),
        force=force,
        hypotheses=found.hypotheses[body] if found.hypotheses else (),
    )
