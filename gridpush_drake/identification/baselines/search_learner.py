"""`SearchLearner`: any search for parameters of a low loss as a method of `identify`."""

from dataclasses import dataclass, field, replace

from gridpush_drake.identification.baselines.search import (
    Bounds,
    SearchMethod,
    SearchStatus,
    run_search,
)
from gridpush_drake.identification.fit.fit_average import MapEnsembleFit
from gridpush_drake.identification.fit.found_model import make_identification
from gridpush_drake.identification.fit.learning_task import (
    Abilities,
    Found,
    LearningTask,
    TouchingPushes,
)
from gridpush_drake.identification.fit.map_ensemble import MapEnsemble
from gridpush_drake.identification.fit.map_fit import calc_laplace
from gridpush_drake.identification.fit.robust_fit import Tracker
from gridpush_drake.identification.result import IdentificationStatus
from gridpush_drake.identification.statistics.noise import NoiseModel
from gridpush_drake.identification.statistics.problem import PushProblem
from gridpush_drake.objects.parameters import CellParameters

DEFAULT_BUDGET_PER_PUSH = 100
"""Number of simulations of each training push where no budget is given."""

WHOLE_CELL = 1.0
"""Part of its side on which a cell bears its load: all of it, as in the paper."""


@dataclass(frozen=True)
class SearchLearner:
    """Learns by a search, and states the spread of what that has found.

    Attributes:
        name: name of the method.
        search: the search.
        ensemble: has the noise model, and the widest prior, by which the spread is calculated.
    """

    name: str
    search: SearchMethod
    ensemble: MapEnsemble = field(default_factory=MapEnsemble)

    @property
    def abilities(self) -> Abilities:
        """It simulates pushes, and needs nothing but their loss."""
        return Abilities(takes_budget=True)

    def learn(self, task: LearningTask) -> Found:
        """Learns an object from the pushes of a task; see `LearningMethod`."""
        pushes = TouchingPushes(task, WHOLE_CELL)
        tracker = Tracker(pushes.problem, task.progress)
        noise = task.adapt_noise(self.ensemble.noise)
        held = pushes.even
        search_end = None
        if len(pushes.screened.log):
            fit, held, search_end = self._search(task, pushes, tracker, noise)
        else:
            fit = replace(self.ensemble, noise=noise).fit_prior(
                task.obj, pushes.z0, pushes.log_contact_friction_std
            )
        model = make_identification(
            task,
            pushes,
            pushes.screened,
            fit,
            held=held,
            method=self.name,
            tracker=tracker,
            noise=noise,
        )
        return Found(model, pushes.screened, search_end=search_end)

    def _search(
        self, task: LearningTask, pushes: TouchingPushes, tracker: Tracker, noise: NoiseModel
    ) -> tuple[MapEnsembleFit, CellParameters, str]:
        """Runs the search.

        Returns:
            A fit with Laplace's spread under the widest prior, the parameters found, and how the
            search ended.
        """
        obj = task.obj
        log = pushes.screened.log
        found = run_search(
            self.search,
            obj,
            log,
            pushes.even,
            Bounds.around(obj, pushes.even),
            budget=DEFAULT_BUDGET_PER_PUSH * len(log) if task.budget is None else task.budget,
            seed=task.seed,
            physics=task.model.physics,
            progress=tracker.add,
        )

        # The searches state no spread of their own. Theirs is that of the exact derivatives at what
        # they found (section 8). The paper's method knows no push height, so that it is set again.
        params = replace(found.params, push_height=pushes.even.push_height)
        final = PushProblem(obj, log, params, task.model.physics)
        z = final.unknowns(params)
        A = self.ensemble.make_widest_factor(obj, pushes.log_contact_friction_std)
        covariance, scale = calc_laplace(final, z, A, noise)
        scaled = noise.scaled(scale)
        spent = found.status == SearchStatus.BUDGET_SPENT
        fit = MapEnsembleFit(
            z=z,
            covariance=covariance,
            prior_covariance=A @ A.T,
            noise_std=scaled.pose,
            load_shift_std=scaled.load_shift,
            status=IdentificationStatus.BUDGET_SPENT if spent else IdentificationStatus.LEARNED,
        )
        return fit, params, found.status
