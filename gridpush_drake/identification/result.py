"""`Identification`, the result of learning: the model, its spread, and how the search went."""

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from gridpush_drake.dynamics.physics import Regime
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.absolute.estimate import AbsoluteEstimate
from gridpush_drake.identification.absolute.force_scale import ForceScale
from gridpush_drake.identification.absolute.masses import draw_absolute_parameters
from gridpush_drake.identification.identifiability import Identifiability
from gridpush_drake.identification.model import Model, check_draws
from gridpush_drake.identification.statistics.noise import NoiseModel, NoiseScale
from gridpush_drake.identification.statistics.outliers import Outlier
from gridpush_drake.identification.statistics.posterior import Posterior, calc_center_jacobian
from gridpush_drake.notebook import count, draw_cells, make_page, make_table
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.units import MM_PER_M


class IdentificationStatus(StrEnum):
    """How an identification ended."""

    LEARNED = "learned"
    PRIOR_KEPT = "prior_kept"
    """The pushes do not speak clearly against uniform friction: an even object explains them best,
    or the model predicts pushes left out no better than it by more than one standard error."""
    BUDGET_SPENT = "budget_spent"
    """A search had to end before it was done."""
    EXPLAINS_LITTLE = "explains_little"
    """The model should not be used: it is far off where the pushes it was learned from ended, it
    predicts them worse than an even object would, or its center of mass is outside the object."""
    NO_DATA = "no_usable_pushes"
    """No push touched the object."""


@dataclass(frozen=True)
class HistoryEntry:
    """One step of a search.

    Attributes:
        simulations: pushes simulated up to here.
        loss: mean cell error of the training pushes at their observed poses, m (the paper's ADD).
        stage: what the search was doing, a word or two.
    """

    simulations: int
    loss: float
    stage: str


Progress = Callable[[HistoryEntry], None]
"""Called now and then with what a search or fit has reached."""


@dataclass(frozen=True, eq=False)
class FitStart:
    """Where a fit ended, and so where one with more pushes may begin.

    Attributes:
        z: (n+1,) log k and log mu_c.
        scale: scale of the noise.
        name: name of the prior that the fit was under; empty for one that serves any prior.
    """

    z: Array
    scale: NoiseScale
    name: str = ""


@dataclass(frozen=True)
class HypothesisEvidence:
    """How well one hypothesis of the object's loads explains the pushes.

    Attributes:
        name: name of the hypothesis, with a number where it stands for several priors.
        log_evidence: log evidence, less that of the best one.
        log_predictive: log density that it gives to the end of each push by what it learns from the
            others, of all pushes, less that of the best one; None of several objects, which are
            weighed by evidence alone.
        weight: fraction of the estimate that comes from it, between 0 and 1.
    """

    name: str
    log_evidence: float
    log_predictive: float | None
    weight: float


@dataclass(frozen=True, eq=False, kw_only=True)
class Identification(Model):
    """A learned model and how far it can be trusted.

    Attributes:
        objects: the object; `obj` is it, too.
        parameters: the estimate of its cells' masses and frictions; `params` is it, too.
        physics: physics of the simulations; its regime is never "auto".
        std: the estimate's standard deviations, in the same shape and units: mass (n,), friction
            (n,), contact_friction.
        posterior: the spread of the relative support friction and the contact friction.
        identifiability: what these data say and what they cannot say.
        method: the method that found it.
        status: how it ended.
        message: the status in a sentence.
        history: the best loss so far along the search, simulations increasing.
        simulations: pushes simulated in all.
        noise_std: standard deviation of what the model leaves unexplained, as cell error per axis,
            m.
        load_shift_std: standard deviation of the center of the load per axis from push to push, m.
        seed: seed of everything random.
        push_names: names of the training pushes that were used.
        unused_pushes: names of the training pushes in which the pusher never touched the object.
        outliers: the pushes that were refused, wholly or in part, each with the reason.
        starts: where each of the default method's fits ended, for `identify(start=...)`; empty for
            other methods.
        force: what measured forces say of the friction's scale; None where there are none.
        interval_scale: factor on the widths of predicted intervals, at most 1. It is less where
            pushes like these end nearer to their predictions than posterior and noise would
            suggest.
        noise: the noise that the method assumed, before it was scaled.
        hypotheses: evidence, predictions and weight of each hypothesis of how the object bears on
            the table; empty for other methods than the default.
        absolute: mass, center of mass and mean friction of an object that was weighed; None of one
            that was not. It may be contradictory, which only `weighed` is not.
        pushed: the model of an object that was weighed, as it was before the weighings were added;
            None of one that was not, and of one that was read from a file.
    """

    std: CellParameters
    posterior: Posterior
    identifiability: Identifiability
    method: str
    status: IdentificationStatus
    message: str
    history: tuple[HistoryEntry, ...]
    simulations: int
    noise_std: float
    load_shift_std: float
    seed: int
    push_names: tuple[str, ...] = ()
    unused_pushes: tuple[str, ...] = ()
    outliers: tuple[Outlier, ...] = ()
    starts: tuple[FitStart, ...] = ()
    force: ForceScale | None = None
    interval_scale: float = 1.0
    noise: NoiseModel = field(default_factory=NoiseModel)
    hypotheses: tuple[HypothesisEvidence, ...] = ()
    absolute: AbsoluteEstimate | None = None
    pushed: "Identification | None" = None

    def __repr__(self) -> str:
        """Object, status and how well it is known, in two lines."""
        std = np.sqrt(
            np.maximum(self.identifiability.center_of_friction_covariance.diagonal(), 0.0)
        )
        x, y = (f"{value * MM_PER_M:.1f}" for value in std)
        pushes = f"{self.status} from {count(len(self.push_names), 'push')}"
        return (
            f"Identification of {self.obj.name!r}, {count(self.obj.n, 'cell')}: {pushes}, "
            f"center of friction known to {x} and {y} mm\n{self.message}"
        )

    def _repr_html_(self) -> str:
        """Outline and cells, colored by their learned mass, and a table of what was found."""
        obj = self.obj
        known = self.identifiability
        x, y = known.center_of_friction * MM_PER_M
        std = np.sqrt(np.maximum(known.center_of_friction_covariance.diagonal(), 0.0)) * MM_PER_M
        params = self.params
        rows: list[tuple[str, str]] = [
            (
                "center of friction, body frame",
                f"x {x:.1f} ± {std[0]:.1f} mm, y {y:.1f} ± {std[1]:.1f} mm",
            ),
            (
                "friction of the pusher",
                f"{params.contact_friction:.2f} ± {self.std.contact_friction:.2f}",
            ),
            ("total mass", f"{params.total_mass:.3g} kg"),
            ("what the model leaves unexplained", f"{self.noise_std * MM_PER_M:.2f} mm"),
            ("simulated as", self.regime.replace("_", " ")),
            ("pushes not touched or refused", str(len(self.unused_pushes) + len(self.outliers))),
        ]
        drawing = draw_cells(
            obj.outline, obj.p_BC, obj.cell_size, params.mass, "mass of a cell, kg"
        )
        return make_page(repr(self), drawing, make_table(("what", "found"), rows))

    @property
    def regime(self) -> Regime:
        """The regime of the simulations, "quasi_static" or "inertial"."""
        return self.physics.regime

    @property
    def weighed(self) -> AbsoluteEstimate | None:
        """What weighings say, to plan and to predict with; None if they contradict each other."""
        absolute = self.absolute
        return None if absolute is None or absolute.contradictory else absolute

    @property
    def unweighed(self) -> "Identification":
        """The model without what weighings say; itself if the object was not weighed."""
        return self if self.pushed is None else self.pushed

    @property
    def parts(self) -> tuple["Identification", ...]:
        """(1,) a model of each object, as `JointIdentification.parts` of several: itself."""
        return (self,)

    @property
    def fit_starts(self) -> tuple[FitStart, ...]:
        """Places where a fit to more pushes may begin."""
        return self.starts or (FitStart(self.posterior.mean, NoiseScale()),)

    @property
    def noise_scale(self) -> NoiseScale:
        """Scale of the noise, in the method's own: how large the pushes said that it is."""
        pose = self.noise_std / self.noise.pose
        load_shift = self.load_shift_std / self.noise.load_shift
        return NoiseScale(pose, load_shift)

    def draws(self, count: int, seed: int = 0) -> list[CellParameters]:
        """Draws parameter sets that agree with the pushes.

        Every cell's friction is the estimate's, unless the object was weighed: then masses and
        frictions vary as far as that leaves them open.

        Args:
            count: how many.
            seed: seed of the draw.

        Returns:
            The parameter sets.

        Raises:
            IdentificationError: the count or the seed is negative.
        """
        check_draws(count, seed)
        weighed = self.weighed
        if weighed is None:
            return self.posterior.draw_parameters(self.params, count, seed)
        return draw_absolute_parameters(self, self.posterior, weighed, count, seed)

    @property
    def relative_friction(self) -> Array:
        """Estimated shares (n,) of the support's friction, k_i = mu_i m_i / sum(mu m)."""
        return self.params.relative_friction()


def calc_center_of_mass(found: Identification) -> tuple[Array, Array]:
    """Calculates where the center of mass is held to be, and how surely, to first order.

        c = sum_i a_i p_i,     a_i = m_i / sum m

    The cells' frictions are held; what they may be is left out: see
    `Identifiability.center_of_mass_box`. Where next to nothing is known, first order says more than
    can be: along no direction is the center less sure than one that may be anywhere in the object.
    A center of mass that was told is where it was told: what pushes show is the center of friction,
    from which it differs as frictions do. That of an object that was weighed is what the weighings
    said.

    Args:
        found: the identification.

    Returns:
        p_BBcm (2,), m, body frame, and its covariance (2, 2), m².
    """
    if found.weighed is not None:
        return found.weighed.center_of_mass, found.weighed.center_covariance
    prior = found.obj.prior
    if prior.center_of_mass is not None:
        return np.array(prior.center_of_mass), prior.center_of_mass_std**2 * np.eye(2)
    center = found.params.center_of_mass(found.obj)
    fraction = found.params.mass / found.params.total_mass
    J = calc_center_jacobian(fraction, found.obj.p_BC)
    return center, _cap(J @ found.posterior.covariance @ J.T, found.obj)


def calc_center_of_friction(found: Identification) -> tuple[Array, Array]:
    """Calculates where the center of friction is, and how surely, to first order.

        c = sum_i x_i p_i,     x_i = k_i / sum k

    It is what pushes show, whatever was weighed.

    Args:
        found: the identification.

    Returns:
        The point (2,), m, body frame, and its covariance (2, 2), m².
    """
    fraction = found.posterior.calc_fraction()
    J = calc_center_jacobian(fraction, found.obj.p_BC)
    return fraction @ found.obj.p_BC, _cap(J @ found.posterior.covariance @ J.T, found.obj)


def _cap(covariance: Array, obj: GridObject) -> Array:
    """Bounds a covariance (2, 2) of a place in the object, m².

    Along no direction is it larger than that of a point that may be anywhere in the cells.
    """
    # With L L^T the cells' covariance, the eigenvalues of L^-1 S L^-T are the ratios.
    arm = obj.p_BC - obj.p_BC.mean(axis=0)
    root = np.linalg.cholesky(arm.T @ arm / obj.n + obj.cell_size**2 / 12 * np.eye(2))
    relative = np.linalg.solve(root, np.linalg.solve(root, covariance).T)
    ratio, directions = np.linalg.eigh(relative)
    if ratio.max() <= 1:
        return covariance
    half = root @ directions
    return np.asarray((half * np.minimum(ratio, 1.0)) @ half.T)
