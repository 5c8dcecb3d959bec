"""`JointEnsemble`: the maps of several objects, and their friction, learned together.

Pushes in which one object pushes another tell of both: how the pushed one answers, and by how much
it holds the other back. So all are learned in one: with z = (log k of every object's cells; log of
the frictions with the pusher; log of the pairs' frictions) and the residuals r(z) of all poses that
were seen, divided by their noise,

    min over z of  sum of rho(|r_b(z)|²) + (z - z_0)^T P^-1 (z - z_0)/2

with a block r_b for all objects at each time of each push. Poses that the model cannot explain
count for little by rho (`robust_least_squares`), and their pushes are named in the result. The
prior of an object's log k is one that a load hypothesis proposes (`fit.hypotheses`), and one number
more for the object as a whole: how heavy it is beside the others (`joint_prior`). First all objects
have smooth fields of one amplitude. Several are fitted, coarse to fine, and the one of greatest
evidence, by Laplace's approximation, is taken. Then the other hypotheses are weighed, object by
object (`object_loads`).

What pushes cannot tell: a factor that all k have in common, for slow pushes only weigh the objects
against each other; and masses by themselves, as for one object (`docs/theory/model.md`, section 7).
The masses that are given stand for k_i = mu_i m_i g with the friction that the object's file names.
Two objects that never pushed each other cannot be compared, either; `JointIdentification` says so.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.dynamics.bodies import Bodies
from gridpush_drake.dynamics.push import make_times_with
from gridpush_drake.dynamics.scene.simulation import simulate_together
from gridpush_drake.errors import IdentificationError
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.fit.hypotheses import (
    DEFAULT_HYPOTHESES,
    LoadHypothesis,
    SmoothField,
    check_names,
    sort_fields,
)
from gridpush_drake.identification.fit.learning_task import Abilities, Found, LearningTask
from gridpush_drake.identification.fit.load_prior import HypothesisInputs
from gridpush_drake.identification.multi_object.joint_forces import learn_from_forces
from gridpush_drake.identification.multi_object.joint_prior import (
    FRICTION_STD,
    JointFit,
    JointPrior,
    fit_fields,
)
from gridpush_drake.identification.multi_object.joint_problem import JointProblem, find_moved
from gridpush_drake.identification.multi_object.joint_result import (
    METHOD,
    UNEXPLAINED,
    JointIdentification,
)
from gridpush_drake.identification.multi_object.object_loads import (
    ObjectFits,
    average_objects,
    weigh_object,
)
from gridpush_drake.identification.prediction import calc_cell_errors
from gridpush_drake.pushes.observed_push import ObservedPush

AMPLITUDES = (0.05, 0.3, 0.7, 1.5)
"""Standard deviations of log k within an object that are tried by default."""

NOISE = (1e-3, 1e-3, 5e-3)
"""Standard deviations of what poses are off from their predictions, m, m and rad: those of seeing
them, and those of the model."""

JOINT_HYPOTHESES: tuple[LoadHypothesis, ...] = (
    *(SmoothField(amplitude) for amplitude in AMPLITUDES),
    *(each for each in DEFAULT_HYPOTHESES if each.field_amplitude is None),
)
"""The hypotheses that are weighed unless others are given: those of one object, but for smooth
fields so uneven that several objects cannot be told apart by them."""


@dataclass(frozen=True)
class JointEnsemble:
    """The method by which several objects are learned together.

    Attributes:
        noise: standard deviations of the poses about their predictions, m, m and rad.
        hypotheses: how each of the objects may bear on the table; the names are unique. Smooth
            fields have one amplitude for all objects; the others are weighed object by object.

    Raises:
        IdentificationError: a number is not positive, there is no smooth field, or two hypotheses
            have the same name.
    """

    noise: tuple[float, float, float] = NOISE
    hypotheses: tuple[LoadHypothesis, ...] = JOINT_HYPOTHESES

    def __post_init__(self) -> None:
        if not (np.isfinite(self.noise).all() and min(self.noise) > 0):
            raise IdentificationError(f"noise is {self.noise!r}; expected positive numbers")
        if all(one.field_amplitude is None for one in self.hypotheses):
            raise IdentificationError(
                "hypotheses: expected at least one smooth field, such as SmoothField(0.7)"
            )
        check_names(self.hypotheses)

    @property
    def name(self) -> str:
        """Name of the method."""
        return METHOD

    @property
    def abilities(self) -> Abilities:
        """It learns several objects, and descends exact gradients."""
        return Abilities(needs_gradients=True, takes_several=True)

    def learn(self, task: LearningTask) -> Found:
        """Learns the objects of a task together; see `LearningMethod`.

        What they begin from changes the result only where there are several minima.

        Raises:
            IdentificationError: learning is to begin from other objects.
        """
        log = task.screened.log
        problem = JointProblem(task.model, log, np.asarray(self.noise))
        begin = problem.z0
        if task.starts:
            begin = task.starts[0].z
        if begin.shape != problem.z0.shape:
            raise IdentificationError(
                f"start: has {len(begin)} unknowns; expected {len(problem.z0)}, those of the same "
                "objects"
            )

        fields = sort_fields(self.hypotheses)
        priors = [_make_prior(problem, field) for field in fields]
        fits = fit_fields(problem, priors, begin)
        if task.starts and max(fits[-1].push_scales) > UNEXPLAINED:
            # What was learned before may be a minimum from which no step leads to a better one.
            others = fit_fields(problem, priors, problem.z0)
            if others[-1].evidence > fits[-1].evidence:
                fits = others
        evidence = np.array([fit.evidence for fit in fits])
        weights = [prior.parts[0].weight for prior in priors]
        chosen = int(np.argmax(evidence + np.log(weights)))
        moves = np.sum([find_moved(seen, self.noise) for seen in log], axis=0)
        best, weighed = self._weigh_objects(fits[chosen], fields[chosen], moves > 0)
        averaged = average_objects(best, weighed)
        learned = problem.make_model(averaged.z)
        z = averaged.z
        covariance = averaged.covariance
        forces = learn_from_forces(learned, z, covariance, log)
        if forces is not None:
            z = forces.z
            covariance = forces.covariance
            learned = problem.make_model(z)
            learned = learned.with_params(*forces.rescale(learned))
        hypotheses = {each.body: each.describe() for each in weighed}
        amplitude = fields[chosen].field_amplitude
        assert amplitude is not None
        model = JointIdentification(
            objects=learned.objects,
            parameters=learned.parameters,
            physics=task.model.physics,
            pair_friction=learned.pair_friction,
            z=z,
            covariance=covariance,
            prior_covariance=best.prior.root @ best.prior.root.T,
            amplitude=float(amplitude),
            evidence=evidence,
            noise=self.noise,
            noise_scale=best.noise_scale,
            push_scales=best.push_scales,
            simulations=problem.simulations,
            push_names=tuple(seen.name for seen in log),
            moves=moves,
            errors_before=calc_end_errors(problem.make_model(problem.z0), log),
            errors=calc_end_errors(learned, log),
            forces=() if forces is None else forces.scales,
            hypotheses=tuple(hypotheses.get(b, ()) for b in range(len(problem.objects))),
        )
        return Found(model, task.screened)

    def _weigh_objects(
        self, fit: JointFit, field: LoadHypothesis, moved: NDArray[np.bool_]
    ) -> tuple[JointFit, list[ObjectFits]]:
        """Weighs what is no smooth field for each object that a push moved, one after another.

        Args:
            fit: the best fit with smooth fields.
            field: the smooth field that it has.
            moved: (N,) which objects a push moved.

        Returns:
            The best fit, and those of each object.
        """
        others = [one for one in self.hypotheses if one.field_amplitude is None]
        weighed: list[ObjectFits] = []
        for body in np.flatnonzero(moved).tolist() if others else []:
            found = weigh_object(fit, field.name, body, others)
            fit = found.best.fit
            weighed.append(found)
        return fit, weighed


def _make_prior(problem: JointProblem, field: LoadHypothesis) -> JointPrior:
    """Makes the prior in which all objects have a smooth field."""
    n = len(problem.objects)
    cells = np.cumsum([obj.n for obj in problem.objects])
    *loads, friction, pairs = np.split(problem.z0, [*cells, cells[-1] + n])
    parts = [
        field.propose(HypothesisInputs(obj, np.append(load, mu), FRICTION_STD))[0]
        for obj, load, mu in zip(problem.objects, loads, friction, strict=True)
    ]
    return JointPrior(tuple(parts), pairs)


def calc_end_errors(bodies: Bodies, pushes: Iterable[ObservedPush]) -> Array:
    """Calculates how far several objects end from where they were seen last.

    Args:
        bodies: the objects, with what is believed of them.
        pushes: P pushes of them.

    Returns:
        (P, N) mean distance of each object's cells, m.
    """
    errors = []
    for seen in pushes:
        times = make_times_with(seen.push, seen.t_observed[-1:], "quasi_static")
        last = int(np.searchsorted(times, seen.t_observed[-1]))
        poses = simulate_together(bodies, seen.push, seen.pose, times=times).poses[last]
        errors.append(calc_cell_errors(bodies.objects, poses, seen.final_pose))
    return np.array(errors)
