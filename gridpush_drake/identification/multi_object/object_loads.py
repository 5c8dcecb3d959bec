"""How each of several objects bears on the table: the load hypotheses, weighed object by object.

The hypotheses are the open list of one object (`fit.hypotheses`). For object b each proposes priors
P_a of that object's unknowns, while the others keep the priors that are best so far. The evidence
E_a of all pushes, also of those in which objects push each other, weighs them:

    w_a ~ p_a exp E_a

with p_a the prior's weight and its fraction of the evidence. A fit takes long where there are many
pushes of several objects. So a prior is first tried on the pushes made linear about the best fit
so far, r = r_0 + J_b dz_b + J_o dz_o, of which the other objects' unknowns dz_o ~ N(0, P_o) are
integrated out:

    log N(r_0 + J_b (m_a - z_0); 0, I + J_o P_o J_o^T + J_b P_a J_b^T)

Only priors that are not much less probable by this are fitted. The best one stays while the next
object is looked at. In the end each object's loads are averaged, as fractions, over its own fits,
and the spread holds their differences; the other objects have their best loads meanwhile. Theory:
`docs/theory/identification.md`, section 12.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import logsumexp, softmax

from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.fit.fit_average import move_center
from gridpush_drake.identification.fit.hypotheses import LoadHypothesis, name_priors
from gridpush_drake.identification.fit.load_prior import (
    HypothesisInputs,
    LinearizedPushes,
    LoadPrior,
)
from gridpush_drake.identification.fit.mode_choice import reduce_rows
from gridpush_drake.identification.multi_object.joint_prior import (
    FRICTION_STD,
    JointFit,
    calc_part_covariance,
    fit_prior,
)
from gridpush_drake.identification.result import HypothesisEvidence
from gridpush_drake.identification.statistics.posterior import CELL_ENTRIES

HOPELESS_GAP = 5.0
"""A prior that is this much less probable than the best one, in its logarithm and by the linear
pushes, is not fitted: it would weigh less than a hundredth."""

MAX_FITS = 2
"""Most priors of an object that are fitted because the linear pushes speak for them."""


@dataclass(frozen=True, eq=False)
class ObjectFit:
    """One prior of one object's loads, and the fit of all objects with it.

    Attributes:
        name: of the prior; the hypothesis' name, with a number where it proposed several.
        part: the prior.
        fit: the fit.
    """

    name: str
    part: LoadPrior
    fit: JointFit

    @property
    def log_weight(self) -> float:
        """Logarithm of what it weighs, up to a constant that all of the object's fits share."""
        return self.fit.evidence + _calc_log_prior(self.part)


@dataclass(frozen=True, eq=False)
class ObjectFits:
    """All fits of one object's loads, the others' being at their best.

    Attributes:
        body: number of the object.
        fits: the fits.
    """

    body: int
    fits: tuple[ObjectFit, ...]

    @property
    def weights(self) -> Array:
        """(F,) what each fit weighs."""
        return np.asarray(softmax([each.log_weight for each in self.fits]))

    @property
    def best(self) -> ObjectFit:
        """The fit that weighs most."""
        return max(self.fits, key=lambda each: each.log_weight)

    def describe(self) -> tuple[HypothesisEvidence, ...]:
        """Says of each how well it explains the pushes; predictions of pushes are not asked for."""
        evidences = [each.fit.evidence for each in self.fits]
        return tuple(
            HypothesisEvidence(
                name=each.name,
                log_evidence=float(evidence - max(evidences)),
                log_predictive=None,
                weight=float(weight),
            )
            for each, evidence, weight in zip(self.fits, evidences, self.weights, strict=True)
        )


def weigh_object(
    fit: JointFit, name: str, body: int, hypotheses: Sequence[LoadHypothesis]
) -> ObjectFits:
    """Weighs hypotheses of one object's loads.

    Args:
        fit: the best fit so far.
        name: of the prior that the object has in it.
        body: number of the object.
        hypotheses: what else its loads may be; no smooth fields.
    """
    problem = fit.problem
    part = fit.prior.parts[body]
    obj = problem.objects[body]
    own = fit.prior.list_unknowns(body)
    pushes = _see_alone(fit, body)
    inputs = HypothesisInputs(obj, problem.z0[own], FRICTION_STD).with_pushes(pushes)
    least = _calc_linear_evidence(pushes, part, inputs.z0) + _calc_log_prior(part) - HOPELESS_GAP
    found = [ObjectFit(name, part, fit)]
    tried = []
    for title, prior in _list_priors(hypotheses, inputs):
        if prior.p_BC is obj.p_BC:
            likely = _calc_linear_evidence(pushes, prior, inputs.z0) + _calc_log_prior(prior)
            tried.append((likely, title, prior))
        else:
            # The pushes were made linear by loads at the cells' centers, and say nothing of it.
            found.append(_fit_part(fit, body, title, prior, prior.mean))
    tried.sort(key=lambda each: each[0], reverse=True)
    for likely, title, prior in tried[:MAX_FITS]:
        if likely > least:
            begin = fit.z[own] if prior.start is None else prior.start
            found.append(_fit_part(fit, body, title, prior, begin))
    return ObjectFits(body, tuple(found))


def average_objects(fit: JointFit, weighed: Sequence[ObjectFits]) -> JointFit:
    """Averages the loads of each object over its own fits.

    Args:
        fit: the best fit of all objects.
        weighed: the fits of each object that was weighed.

    Returns:
        The best fit with the averages in their place, and the spread of each object's fits about
        its average added; loads are at the cells' centers.
    """
    z = fit.z.copy()
    covariance = fit.covariance.copy()
    for each in weighed:
        own = fit.prior.list_unknowns(each.body)
        obj = each.fits[0].fit.problem.objects[each.body]
        # Loads at other points than the cells' are carried over, so that their center stays.
        points = [
            one.fit.z[own]
            if one.part.p_BC is obj.p_BC
            else move_center(obj.p_BC, one.fit.z[own], one.part.p_BC)
            for one in each.fits
        ]
        average = _average(np.array(points), each.weights)
        off = np.array(points) - average
        covariance[np.ix_(own, own)] += (each.weights[:, None] * off).T @ off
        z[own] = average
    return replace(fit, z=z, covariance=covariance)


def _average(points: Array, weights: Array) -> Array:
    """Averages an object's unknowns (F, n+1): its loads as fractions, the rest as it is."""
    average = np.asarray(weights @ points)
    loads = points[:, CELL_ENTRIES]
    level = logsumexp(loads, axis=1)
    fractions = np.exp(loads - level[:, None])
    average[CELL_ENTRIES] = np.log(weights @ fractions) + weights @ level
    return average


def _fit_part(fit: JointFit, body: int, name: str, part: LoadPrior, begin: Array) -> ObjectFit:
    """Fits all objects with another prior of one, whose unknowns begin at z (n+1,)."""
    prior = fit.prior.replace_part(body, part)
    start = fit.z.copy()
    start[prior.list_unknowns(body)] = begin
    problem = fit.problem.move_cells(body, part.p_BC)
    return ObjectFit(name, part, fit_prior(problem, prior, start))


def _list_priors(
    hypotheses: Sequence[LoadHypothesis], inputs: HypothesisInputs
) -> Iterator[tuple[str, LoadPrior]]:
    """Lists the priors that hypotheses propose, each with a name."""
    alone = replace(inputs, pushes=None)
    for hypothesis in hypotheses:
        yield from name_priors(hypothesis, inputs if hypothesis.needs_pushes else alone)


def _calc_log_prior(part: LoadPrior) -> float:
    """Logarithm of a prior's weight, and of its fraction of the evidence."""
    return float(np.log(part.weight) + np.log(part.evidence_fraction))


def _see_alone(fit: JointFit, body: int) -> LinearizedPushes:
    """Makes the pushes linear in one object's unknowns, with those of the others integrated out."""
    residuals, derivatives = fit.problem.linearize(fit.z)
    roots = np.repeat(np.sqrt(fit.weights), residuals.shape[1])
    J = roots[:, None] * derivatives.reshape(len(roots), -1)
    own = fit.prior.list_unknowns(body)
    mean = fit.prior.mean.copy()
    mean[own] = fit.problem.z0[own]
    r = roots * residuals.ravel() + J @ (mean - fit.z)
    telling = J.any(axis=1)
    reduced = reduce_rows(LinearizedPushes(r[telling], J[telling]))
    others = np.setdiff1d(np.arange(len(mean)), own)
    A = reduced.J @ fit.prior.root[:, others]
    L = np.linalg.cholesky(np.eye(len(A)) + A @ A.T)
    seen = solve_triangular(L, np.column_stack([reduced.residuals, reduced.J[:, own]]), lower=True)
    return LinearizedPushes(seen[:, 0], seen[:, 1:])


def _calc_linear_evidence(pushes: LinearizedPushes, part: LoadPrior, z0: Array) -> float:
    """Calculates the log evidence of an object's prior by linear pushes, up to a constant."""
    J = pushes.J
    r = pushes.residuals + J @ (part.mean - z0)
    L = np.linalg.cholesky(np.eye(len(r)) + J @ calc_part_covariance(part) @ J.T)
    whitened = solve_triangular(L, r, lower=True)
    return float(-0.5 * whitened @ whitened - np.log(np.diag(L)).sum())
