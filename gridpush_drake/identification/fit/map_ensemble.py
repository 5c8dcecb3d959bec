"""The default identifier: hypotheses of how the object bears on the table, fitted and weighed.

The hypotheses are an open list (`hypotheses`). Each proposes normal priors of z; for each prior z
is fitted by Gauss-Newton (`map_fit`). The smooth fields are fitted in the order of their
amplitudes, each from where the last one ended: coarse to fine. Where the best of them leaves much
unexplained it may be a poor optimum; then fits begin with loads that are tilted to all sides
(`docs/theory/identification.md`, section 5).

What a hypothesis says stands in `hypotheses`, how the fits are averaged in `fit_average`, and what
becomes of pushes that contradict the others in `robust_fit`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from scipy.special import logsumexp

from gridpush_drake.errors import IdentificationError, ParameterError
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.fit.fit_average import (
    HOPELESS_EVIDENCE_GAP,
    Candidate,
    MapEnsembleFit,
    average_fits,
)
from gridpush_drake.identification.fit.flipped_poses import find_flipped_poses
from gridpush_drake.identification.fit.found_model import make_identification
from gridpush_drake.identification.fit.frame_fit import fit_frame
from gridpush_drake.identification.fit.hypotheses import (
    CENTER_STD,
    DEFAULT_HYPOTHESES,
    LoadHypothesis,
    check_names,
    name_priors,
    sort_fields,
)
from gridpush_drake.identification.fit.learning_task import (
    Abilities,
    Found,
    LearningTask,
    TouchingPushes,
)
from gridpush_drake.identification.fit.linearized_fit import solve_factor
from gridpush_drake.identification.fit.load_modes import calc_material_loads
from gridpush_drake.identification.fit.load_prior import (
    HypothesisInputs,
    LinearizedPushes,
    LoadPrior,
)
from gridpush_drake.identification.fit.map_fit import (
    MapFit,
    fit_map,
    replace_contact_friction,
    scan_contact_friction,
)
from gridpush_drake.identification.fit.robust_fit import Fitter, Tracker, fit_robustly
from gridpush_drake.identification.result import FitStart, IdentificationStatus
from gridpush_drake.identification.statistics.center_of_mass import CenterOfMass
from gridpush_drake.identification.statistics.noise import POSE_SIZE, NoiseModel, NoiseScale
from gridpush_drake.identification.statistics.posterior import CELL_ENTRIES
from gridpush_drake.identification.statistics.problem import Linearization, PushProblem
from gridpush_drake.objects.grid_object import GridObject

FIRST_EVALUATIONS = 6
"""Each fit first simulates the pushes at most this often. When all fits have begun, only those that
may still come to count are carried on."""

POOR_SCALE = 1.0
"""If the noise scale at the best smooth field is above this, it may be a poor optimum, and fits
begin anew from tilted loads."""

POOR_FIT_DISTANCE = 10.0
"""If a push ends more than this many standard deviations from its prediction, the optimum is
probably a poor one (it explains the push away by being sensitive to where it began), and fits begin
anew from tilted loads."""

TILT_DIRECTIONS = 8
"""Number of directions in which loads are tilted for fits that begin anew."""

TILT_SIZES = (1.0, 2.5)
"""Sizes of these tilts: change of log k over one radius of gyration."""

TILTED_FITS = 3
"""Number of tilted loads, those that predict the pushes best, that fits begin anew from."""

TILTED_AMPLITUDE = 1.5
"""Fits from tilted loads are of the smooth field whose amplitude is nearest to this one."""


@dataclass(frozen=True)
class MapEnsemble:
    """The default identifier, and what it takes for granted.

    Attributes:
        hypotheses: how the object may bear on the table; the names are unique.
        noise: the noise model.
        patch_ratio: on what part of its side a cell bears its load, see `CellParameters`; None for
            n^(-1/2): a rigid body stands on points, but the only cell of an object is all of it.
    """

    hypotheses: tuple[LoadHypothesis, ...] = DEFAULT_HYPOTHESES
    noise: NoiseModel = field(default_factory=NoiseModel)
    patch_ratio: float | None = None

    def __post_init__(self) -> None:
        """Raises IdentificationError: no hypothesis is fitted first, or two have the same name."""
        if all(one.needs_pushes for one in self.hypotheses):
            raise IdentificationError(
                "hypotheses: expected at least one that needs no pushes, such as SmoothField(1.5)"
            )
        check_names(self.hypotheses)

    def choose_patch_ratio(self, obj: GridObject) -> float:
        """On what part of its side a cell of the object bears its load."""
        return float(obj.n**-0.5) if self.patch_ratio is None else self.patch_ratio

    @property
    def name(self) -> str:
        """Name of the method."""
        return "default"

    @property
    def abilities(self) -> Abilities:
        """It descends exact gradients, and holds what it is told of frictions."""
        return Abilities(
            needs_gradients=True, takes_overhang=True, holds_friction=True, fits_frame=True
        )

    @property
    def fields(self) -> list[LoadHypothesis]:
        """Smooth fields, by increasing amplitude; the shipped ones if the ensemble has none."""
        return sort_fields(self.hypotheses) or sort_fields(DEFAULT_HYPOTHESES)

    @property
    def widest(self) -> LoadHypothesis:
        """Smooth field of the largest amplitude, which stands for what is held before any push."""
        return self.fields[-1]

    def learn(self, task: LearningTask) -> Found:
        """Learns an object from the pushes of a task; see `LearningMethod`.

        Raises:
            IdentificationError: no loads explain the pushes with what is told of the object.
        """
        ensemble = replace(self, noise=task.adapt_noise(self.noise))
        frame = None
        if task.fit_frame:
            frame = fit_frame(task.obj, partial(ensemble._fit_at, task))
            task = task.move(frame.place(task.obj))
        pushes = TouchingPushes(task, self.choose_patch_ratio(task.obj))
        tracker = Tracker(pushes.problem, task.progress)
        known: dict[str, Any] = {
            "z0": pushes.z0,
            "log_contact_friction_std": pushes.log_contact_friction_std,
            "center_of_mass": CenterOfMass.of_prior(task.obj.prior),
        }
        fitter = Fitter(
            fit_all=partial(ensemble.fit, **known, on_step=tracker.report),
            fit_few=partial(ensemble.fit_field, **known),
            tracker=tracker,
        )
        kept = pushes.screened
        if len(kept.log):
            try:
                fit, kept = fit_robustly(fitter, pushes.problem, kept, task.starts, task.seed)
            except (np.linalg.LinAlgError, ParameterError) as error:
                raise IdentificationError(_describe_no_fit(task.obj)) from error
        else:
            z = pushes.z0.copy()
            z[CELL_ENTRIES] += calc_material_loads(task.obj)
            fit = ensemble.fit_prior(task.obj, z, pushes.log_contact_friction_std)
        if frame is not None:
            fit = replace(fit, covariance=frame.widen(fit.covariance))
        model = make_identification(
            task,
            pushes,
            kept,
            fit,
            held=pushes.even,
            noise=ensemble.noise,
            method=self.name,
            tracker=tracker,
        )
        # Which way round symmetric objects were seen is asked of all pushes, also of those refused.
        touching = pushes.screened.log
        flipped = find_flipped_poses(
            pushes.problem.replace_log(touching),
            touching,
            kept.log,
            pushes.z0,
            ensemble.noise,
            fitter.fit_few,
        )
        return Found(model, kept, flipped)

    def _fit_at(self, task: LearningTask, obj: GridObject) -> MapFit | None:
        """Fits one smooth field to the pushes that touch the object where it was moved to.

        Returns:
            The fit; None where no push touches it.
        """
        pushes = TouchingPushes(task.move(obj), self.choose_patch_ratio(obj))
        if not len(pushes.problem):
            return None
        return self.fit_field(
            pushes.problem,
            pushes.z0,
            pushes.log_contact_friction_std,
            CenterOfMass.of_prior(obj.prior),
        )

    def fit(
        self,
        problem: PushProblem,
        z0: Array,
        log_contact_friction_std: float,
        center_of_mass: CenterOfMass | None,
        on_step: Callable[[Array, Linearization], None],
        starts: tuple[FitStart, ...] = (),
    ) -> MapEnsembleFit:
        """Fits every prior that the hypotheses propose, and averages.

        Args:
            problem: the training pushes; at least one.
            z0: (n+1,) prior mean of z.
            log_contact_friction_std: prior standard deviation of log mu_c.
            center_of_mass: prior knowledge; None stands for CENTER_STD about the cells' centroid.
            on_step: called with z and the pushes' residuals and derivatives there after every step.
            starts: where fits to fewer pushes ended. A fit begins at the one of its name (or at the
                one without a name) if that is more probable than where it would begin otherwise.

        Returns:
            The fit.
        """
        center_of_mass = center_of_mass or _hold_center(problem.obj)
        setting = HypothesisInputs(problem.obj, z0, log_contact_friction_std)
        fit_one = partial(fit_map, noise=self.noise, center_of_mass=center_of_mass, on_step=on_step)
        candidates = self._fit_unconditional(problem, setting, fit_one, starts)
        _begin_with_friction(candidates, fit_one)
        _begin_with_tilts(candidates, self.noise, fit_one)
        _follow_best(candidates, fit_one)
        # The pushes, made linear about the best fit so far, choose the priors of the others.
        best = candidates[_find_best(candidates)].fit
        residuals, J = best.linearized.linearize_at_prior()
        setting = setting.with_pushes(LinearizedPushes(residuals, J, len(center_of_mass.at)))
        candidates += self._fit_conditional(problem, setting, fit_one, best)
        # Only fits that may still come to count are carried to their end.
        best_evidence = max(one.log_evidence for one in candidates)
        for i, one in enumerate(candidates):
            if not one.fit.settled and one.log_evidence > best_evidence - HOPELESS_EVIDENCE_GAP:
                fit = fit_one(
                    one.problem,
                    one.prior.mean,
                    one.prior.factor,
                    start=FitStart(one.fit.z, one.fit.scale),
                    linear=one.fit.linear,
                )
                candidates[i] = replace(one, fit=fit)
        return average_fits(problem, candidates, self.noise)

    def fit_field(
        self,
        problem: PushProblem,
        z0: Array,
        log_contact_friction_std: float,
        center_of_mass: CenterOfMass | None,
    ) -> MapFit:
        """Fits one smooth field of a middle amplitude alone, with the arguments of `fit`."""
        setting = HypothesisInputs(problem.obj, z0, log_contact_friction_std)
        fields = sort_fields(self.hypotheses) or [self.widest]
        prior = min(fields, key=_calc_distance_to_middle).propose(setting)[0]
        return fit_map(
            problem,
            prior.mean,
            prior.factor,
            self.noise,
            center_of_mass or _hold_center(problem.obj),
        )

    def fit_prior(
        self, obj: GridObject, z0: Array, log_contact_friction_std: float
    ) -> MapEnsembleFit:
        """Gives the widest prior, where no push touched the object."""
        A = self.make_widest_factor(obj, log_contact_friction_std)
        return MapEnsembleFit(
            z=z0,
            covariance=A @ A.T,
            prior_covariance=A @ A.T,
            noise_std=self.noise.pose,
            load_shift_std=self.noise.load_shift,
            status=IdentificationStatus.NO_DATA,
        )

    def make_widest_factor(self, obj: GridObject, log_contact_friction_std: float) -> Array:
        """Makes the factor (n+1, n+1) of z's prior covariance under the widest smooth field."""
        setting = HypothesisInputs(obj, np.zeros(obj.n + 1), log_contact_friction_std)
        return self.widest.propose(setting)[0].factor

    def _fit_unconditional(
        self,
        problem: PushProblem,
        setting: HypothesisInputs,
        fit_one: Callable[..., MapFit],
        starts: tuple[FitStart, ...],
    ) -> list[Candidate]:
        """Fits the priors that do not depend on the pushes, the smooth fields coarse to fine."""
        others = [
            one for one in self.hypotheses if one.field_amplitude is None and not one.needs_pushes
        ]
        ordered = [*sort_fields(self.hypotheses), *others]
        warm = {start.name: start for start in starts}
        candidates: list[Candidate] = []
        last: MapFit | None = None  # of the smooth field before
        for hypothesis in ordered:
            for name, prior in name_priors(hypothesis, setting):
                begin = None
                linear = None
                if prior.start is not None:
                    begin = FitStart(prior.start, NoiseScale())
                elif hypothesis.field_amplitude is not None and last is not None:
                    # A wider field explains no less than a narrower one did.
                    scale = NoiseScale(*np.minimum(last.scale, 1.0).tolist())
                    begin = FitStart(last.z, scale)
                    linear = last.linear
                candidate = _fit_prior(
                    problem,
                    hypothesis,
                    name,
                    prior,
                    fit_one,
                    start=begin,
                    linear=linear,
                    warm_start=warm.get(name, warm.get("")),
                )
                candidates.append(candidate)
                if hypothesis.field_amplitude is not None:
                    last = candidate.fit
        return candidates

    def _fit_conditional(
        self,
        problem: PushProblem,
        setting: HypothesisInputs,
        fit_one: Callable[..., MapFit],
        best: MapFit,
    ) -> list[Candidate]:
        """Fits the priors that were chosen by the pushes, made linear about the best fit so far."""
        candidates = []
        for hypothesis in self.hypotheses:
            if not hypothesis.needs_pushes:
                continue
            for name, prior in name_priors(hypothesis, setting):
                candidate = _fit_prior(
                    problem,
                    hypothesis,
                    name,
                    prior,
                    fit_one,
                    start=FitStart(best.z, best.scale),
                    linear=best.linear,
                    warm_start=None if prior.start is None else FitStart(prior.start, best.scale),
                )
                candidates.append(candidate)
        return candidates


def _find_fields(candidates: Sequence[Candidate]) -> list[int]:
    """Indices of the smooth fields, by increasing amplitude."""
    return [i for i, one in enumerate(candidates) if one.hypothesis.field_amplitude is not None]


def _find_best(candidates: Sequence[Candidate]) -> int:
    """Index of the most probable of the smooth fields; of all candidates if there are none."""
    fields = _find_fields(candidates) or range(len(candidates))
    return max(fields, key=lambda i: candidates[i].log_evidence)


def _calc_distance_to_middle(one: LoadHypothesis) -> float:
    """Distance of a smooth field's log amplitude from that with which tilted loads are fitted."""
    assert one.field_amplitude is not None
    return float(np.abs(np.log(one.field_amplitude / TILTED_AMPLITUDE)))


def _begin_with_friction(candidates: list[Candidate], fit_one: Callable[..., MapFit]) -> None:
    """Fits anew with another contact friction, where that explains the pushes better."""
    friction = scan_contact_friction(candidates[_find_best(candidates)].fit)
    if friction is None:
        return
    for i, one in enumerate(candidates):
        start = FitStart(replace_contact_friction(one.fit.z, friction), one.fit.scale)
        again = fit_one(
            one.problem,
            one.prior.mean,
            one.prior.factor,
            start=start,
            max_evaluations=FIRST_EVALUATIONS,
        )
        if again.log_evidence > one.log_evidence:
            candidates[i] = replace(one, fit=again)


def _begin_with_tilts(
    candidates: list[Candidate], noise: NoiseModel, fit_one: Callable[..., MapFit]
) -> None:
    """Fits one smooth field anew from tilted loads where the best one is probably a poor optimum.

    That is where it leaves much unexplained, or a push ends far off, or its neighbors are much
    worse.
    """
    fields = _find_fields(candidates)
    if not fields:
        return
    best = _find_best(candidates)
    place = fields.index(best)
    beside = [*fields[max(place - 1, 0) : place], *fields[place + 1 : place + 2]]
    neighbor = max((candidates[i].log_evidence for i in beside), default=np.inf)
    fit = candidates[best].fit
    farthest = max(np.linalg.norm(r[-POSE_SIZE:]) for r in fit.linear.residuals)
    scale = fit.scale.pose
    explains = scale < POOR_SCALE and farthest < POOR_FIT_DISTANCE * scale * noise.pose
    if explains and neighbor > fit.log_evidence - HOPELESS_EVIDENCE_GAP:
        return
    middle = min(fields, key=lambda i: _calc_distance_to_middle(candidates[i].hypothesis))
    prior = candidates[middle].prior
    problem = candidates[middle].problem
    tilted = tilt_loads(problem.obj, prior.mean)
    errors = [problem.calc_cell_errors(problem.residuals(z)).mean() for z in tilted]
    for i in np.argsort(errors, kind="stable")[:TILTED_FITS]:
        again = fit_one(problem, prior.mean, prior.factor, start=FitStart(tilted[i], NoiseScale()))
        if again.log_evidence > candidates[middle].log_evidence:
            candidates[middle] = replace(candidates[middle], fit=again)


def _follow_best(candidates: list[Candidate], fit_one: Callable[..., MapFit]) -> None:
    """Fits the other smooth fields anew from where their neighbor ended, where that is better."""
    fields = _find_fields(candidates)
    if not fields:
        return
    place = fields.index(_find_best(candidates))
    narrower = [(i, i + 1) for i in reversed(range(place))]
    wider = [(i, i - 1) for i in range(place + 1, len(fields))]
    for own_place, near_place in [*narrower, *wider]:
        one = candidates[fields[own_place]]
        near = candidates[fields[near_place]].fit
        if one.log_evidence > near.log_evidence - HOPELESS_EVIDENCE_GAP:
            continue
        own = one.fit.linearized
        u = solve_factor(one.prior.factor, near.z - one.prior.mean)
        if own.move(u, near.linear).rescale(near.scale).objective() < own.objective():
            fit = fit_one(
                one.problem,
                one.prior.mean,
                one.prior.factor,
                start=FitStart(near.z, near.scale),
                linear=near.linear,
                max_evaluations=FIRST_EVALUATIONS,
            )
            candidates[fields[own_place]] = replace(one, fit=fit)


def _fit_prior(
    problem: PushProblem,
    hypothesis: LoadHypothesis,
    name: str,
    prior: LoadPrior,
    fit_one: Callable[..., MapFit],
    *,
    start: FitStart | None,
    linear: Linearization | None,
    warm_start: FitStart | None,
) -> Candidate:
    """Fits one prior, with the cells' loads at the points where it puts them.

    Args:
        problem: the training pushes, with loads at the cells' centers.
        hypothesis: the hypothesis that proposes the prior.
        name: the prior's name.
        prior: the prior.
        fit_one: makes a fit.
        start: where it begins; None for the prior mean.
        linear: the pushes' residuals and derivatives there, with loads at the cells' centers; None
            where they are not known.
        warm_start: where else it may begin; None for nowhere else.
    """
    on_grid = prior.p_BC is problem.obj.p_BC
    moved = problem if on_grid else problem.move_cells(prior.p_BC)
    fit = fit_one(
        moved,
        prior.mean,
        prior.factor,
        start=start,
        linear=linear if on_grid else None,
        warm_start=warm_start,
        max_evaluations=FIRST_EVALUATIONS,
    )
    return Candidate(
        name=name,
        hypothesis=hypothesis,
        prior=prior,
        problem=moved,
        on_grid=on_grid,
        fit=fit,
    )


def _hold_center(obj: GridObject) -> CenterOfMass:
    """Holds the center of mass where the parts' materials put it, if nothing else is known of it.

    That is the cells' centroid where no materials are told.
    """
    x, y = np.average(obj.p_BC, axis=0, weights=np.exp(calc_material_loads(obj)))
    return CenterOfMass((x, y), CENTER_STD * obj.radius_of_gyration)


def tilt_loads(obj: GridObject, z0: Array) -> list[Array]:
    """Makes points whose loads grow exponentially across the object, each in another direction.

    Args:
        obj: the object.
        z0: (n+1,) the point whose total load they keep.

    Returns:
        The points z (n+1,); none of an object of one cell, whose load has nowhere to go.
    """
    if obj.n == 1:
        return []
    arm = obj.p_BC - obj.p_BC.mean(axis=0)
    arm /= np.sqrt((arm**2).sum(axis=1).mean())
    tilted = []
    for size in TILT_SIZES:
        for angle in np.arange(TILT_DIRECTIONS) * (2 * np.pi / TILT_DIRECTIONS):
            z = z0.copy()
            z[CELL_ENTRIES] += size * (arm @ [np.cos(angle), np.sin(angle)])
            z[CELL_ENTRIES] += logsumexp(z0[CELL_ENTRIES]) - logsumexp(z[CELL_ENTRIES])
            tilted.append(z)
    return tilted


def _describe_no_fit(obj: GridObject) -> str:
    """Says which of what was told of an object may be why its fit's equations cannot be solved."""
    prior = obj.prior
    given = []
    if prior.center_of_mass is not None:
        x, y = prior.center_of_mass
        given.append(f"center_of_mass.at, [{x:g}, {y:g}] m,")
    if prior.push_height is not None:
        given.append(f"pusher.height, {prior.push_height:g} m,")
    question = f"; is {' and '.join(given)} right?" if given else ""
    return (
        f"{obj.name}: the fit's equations cannot be solved, "
        f"no loads of its cells explain the pushes{question}"
    )
