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

      log k ~ N(log k_0, a_o² C + sigma_o² h h^T);

* `UniformParts`: the cells of a part are of one material, for the object's file says that they may
  be. With h_p = 1 on part p and 0 beside it, less the mean, and b = 1 where two parts meet,

      log k ~ N(log k_0, a_u² C + sigma_u² sum_p h_p h_p^T + sigma_b² diag(b));

* `NamedMaterials`: the same, with the densities that the object's file tells of its parts. With m
  the logarithm of these densities, scaled to the whole load, and s_p how far the part's may be off,

      log k ~ N(log k_0 + m, a_u² C + sum_p s_p² h_p h_p^T + sigma_b² diag(b))

A further hypothesis is a class that inherits `LoadHypothesis`, passed as
`identify(..., method=MapEnsemble(hypotheses=(*DEFAULT_HYPOTHESES, Mine())))`. Theory:
`docs/theory/identification.md`, sections 3 and 5. The fits themselves are made in `map_fit`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Protocol

import numpy as np

from gridpush_drake.errors import IdentificationError
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.fit.load_modes import (
    calc_material_loads,
    calc_material_stds,
    calc_part_modes,
    calc_radius_mode,
    find_corners,
    find_cuts,
    find_part_borders,
    find_rings,
)
from gridpush_drake.identification.fit.load_prior import (
    RANGE_CELLS,
    HypothesisInputs,
    LoadPrior,
    calc_prior_factor,
)
from gridpush_drake.identification.fit.mode_choice import (
    calc_linear_step,
    propose_modes,
    reduce_rows,
)
from gridpush_drake.identification.statistics.posterior import CELL_ENTRIES

FIELD_AMPLITUDES = (0.05, 0.3, 0.7, 1.5, 3.0, 6.0)
"""Standard deviations of log k of the shipped smooth fields; the first is an almost even object."""

EVEN_AMPLITUDE = 0.1
"""A smooth field whose cells differ by no more than this standard deviation of log k stands for an
even object."""

AMPLITUDE_EXPONENT = 0.65
"""A smooth field of amplitude a has the prior weight a^-WEAKNESS, so that a few noisy pushes do not
talk the model out of an even object."""

CENTER_STD = 0.6
"""Standard deviation per axis of the center of friction about the cells' centroid where nothing is
known of the center of mass, in radii of gyration."""


class LoadHypothesis(Protocol):
    """One idea of how an object bears on the table; a class that inherits it is one.

    Attributes:
        name: short name, unique in an ensemble; results and reports show it.
        needs_pushes: whether `propose` looks at `HypothesisInputs.pushes`. Such hypotheses are
            asked last, with the pushes made linear about the best fit of the others.
        field_amplitude: standard deviation of log k of a smooth field; None of any other
            hypothesis. Smooth fields are fitted first and coarse to fine, each from where the one
            of the next smaller amplitude ended.
    """

    @property
    def name(self) -> str:
        """Short name, unique in an ensemble."""
        ...

    @property
    def needs_pushes(self) -> bool:
        """False: the priors are the same for all pushes."""
        return False

    @property
    def field_amplitude(self) -> float | None:
        """None: it is no smooth field."""
        return None

    def propose(self, setting: HypothesisInputs) -> Sequence[LoadPrior]:
        """Proposes priors of z for an object; none where the idea does not apply to it."""
        ...


def _check_positive(hypothesis: "SmoothField | Concentrated | Ring | UniformParts") -> None:
    """Raises IdentificationError: a number of a hypothesis is not positive and finite."""
    for field in fields(hypothesis):
        value = getattr(hypothesis, field.name)
        if not 0 < value < np.inf:
            raise IdentificationError(
                f"{type(hypothesis).__name__}: {field.name} is {value}; "
                "expected a positive finite number"
            )


@dataclass(frozen=True)
class SmoothField(LoadHypothesis):
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
    def field_amplitude(self) -> float:
        """The amplitude a."""
        return self.amplitude

    def propose(self, setting: HypothesisInputs) -> list[LoadPrior]:
        """Proposes the smooth field."""
        prior = LoadPrior(
            mean=setting.z0,
            factor=calc_prior_factor(
                setting.calc_smooth_covariance(self.range_cells),
                self.amplitude,
                setting.log_contact_friction_std,
            ),
            weight=self.amplitude**-AMPLITUDE_EXPONENT,
            p_BC=setting.obj.p_BC,
            stands_for_even=self.amplitude <= EVEN_AMPLITUDE,
        )
        return [prior]


@dataclass(frozen=True)
class RigidBottom(LoadHypothesis):
    """A flat rigid bottom stands on corners of the outline's convex hull, whichever bear most.

    Attributes:
        weight: prior weight. (All shipped smooth fields together weigh 12.0.) With more, one push
            alone could take a heavy head for a body on corners.
        corner_std: standard deviation of log k at a corner; it is large because some corners bear
            next to nothing.
        rest_fraction: fraction of the load that rests on all other cells together.
        rest_std: standard deviation of log k of those.
    """

    weight: float = 0.05
    corner_std: float = 2.5
    rest_fraction: float = 0.02
    rest_std: float = 0.05

    @property
    def name(self) -> str:
        """Short name."""
        return "rigid bottom"

    def propose(self, setting: HypothesisInputs) -> list[LoadPrior]:
        """Proposes loads at the corners, where no cell has its center."""
        obj = setting.obj
        corners, p_corners = find_corners(obj)
        rest = np.setdiff1d(np.arange(obj.n), corners)
        mean = setting.z0.copy()
        mean[rest] += np.log(self.rest_fraction * len(corners) / max(len(rest), 1))
        variance = np.full(obj.n, self.corner_std**2)
        variance[rest] = self.rest_std**2
        p_BC = obj.p_BC.copy()
        p_BC[corners] = p_corners
        factor = calc_prior_factor(np.diag(variance), 1.0, setting.log_contact_friction_std)
        return [LoadPrior(mean=mean, factor=factor, weight=self.weight, p_BC=p_BC)]


@dataclass(frozen=True)
class Concentrated(LoadHypothesis):
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

    def propose(self, setting: HypothesisInputs) -> list[LoadPrior]:
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
class TwoParts(LoadHypothesis):
    """The object is of two parts, as of steel and of wood, that meet at a straight cut.

    Every cut that leaves both parts a fraction of the cells is scored to first order; the best few,
    no two alike, are proposed.

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

    def propose(self, setting: HypothesisInputs) -> list[LoadPrior]:
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
class Ring(LoadHypothesis):
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

    def propose(self, setting: HypothesisInputs) -> list[LoadPrior]:
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


@dataclass(frozen=True)
class UniformParts(LoadHypothesis):
    """The cells of a part are of one material, such as a head of steel and a handle of wood.

    It is for objects whose file says so (`PhysicalPrior.uniform_parts`): parts by the colors of a
    photograph, or the labels of a mask. Colors may lie, so that it is weighed as all others are.

    Attributes:
        weight: prior weight. (All shipped smooth fields together weigh 12.0.)
        part_std: sigma_u, standard deviation of log k of a part.
        amplitude: a_u, standard deviation of log k within a part.
        border_std: sigma_b, standard deviation of log k, beside that, of a cell that is next to
            another part: the border may run through it.
        range_cells: correlation range within a part, cells.
    """

    weight: float = 12.0
    part_std: float = 1.5
    amplitude: float = 0.1
    border_std: float = 0.5
    range_cells: float = RANGE_CELLS

    def __post_init__(self) -> None:
        """Raises IdentificationError: a number is not positive and finite."""
        _check_positive(self)

    @property
    def name(self) -> str:
        """Short name."""
        return "uniform parts"

    @property
    def needs_pushes(self) -> bool:
        """True: its fit may begin where the pushes, made linear, put the parts."""
        return True

    def propose(self, setting: HypothesisInputs) -> list[LoadPrior]:
        """Proposes it where the parts are known, and there are several."""
        obj = setting.obj
        prior = obj.prior
        seen = prior.uniform_parts or prior.materials
        if not seen or (obj.labels == obj.labels[0]).all():
            return []
        parts = len(np.unique(obj.labels))
        return [self._make_prior(setting, np.zeros(obj.n), np.full(parts, self.part_std))]

    def _make_prior(self, setting: HypothesisInputs, m: Array, part_stds: Array) -> LoadPrior:
        """Makes the prior about log k_0 + m.

        Args:
            setting: the object, with the training pushes.
            m: (n,) expected log k, less log k_0.
            part_stds: (parts,) s_p, standard deviation of log k of each part.
        """
        obj = setting.obj
        # C(log k) = a_u² C + sum_p s_p² h_p h_p^T + sigma_b² diag(b)
        h = part_stds[:, None] * calc_part_modes(obj)
        C = setting.calc_smooth_covariance(self.range_cells)
        covariance = self.amplitude**2 * C + h.T @ h
        border = find_part_borders(obj)
        covariance[border, border] += self.border_std**2
        factor = calc_prior_factor(covariance, 1.0, setting.log_contact_friction_std)
        mean = setting.z0.copy()
        mean[CELL_ENTRIES] += m
        assert setting.pushes is not None
        pushes = reduce_rows(setting.pushes).shift(mean - setting.z0)
        return LoadPrior(
            mean=mean,
            factor=factor,
            weight=self.weight,
            p_BC=obj.p_BC,
            start=mean + calc_linear_step(pushes, factor),
        )


@dataclass(frozen=True)
class NamedMaterials(UniformParts):
    """The parts are of the materials that the object's file names, such as steel and wood.

    It is for objects whose file has densities of parts (`PhysicalPrior.materials`). They may be
    wrong by more than they say, so that it is weighed beside `UniformParts`, which knows of none.
    Its attributes are those of `UniformParts`; `part_std` is for parts whose material is not told.
    """

    @property
    def name(self) -> str:
        """Short name."""
        return "named materials"

    def propose(self, setting: HypothesisInputs) -> list[LoadPrior]:
        """Proposes it where a part's material is told, and there are several parts."""
        obj = setting.obj
        if not obj.prior.materials or (obj.labels == obj.labels[0]).all():
            return []
        stds = calc_material_stds(obj, self.part_std)
        return [self._make_prior(setting, calc_material_loads(obj), stds)]


DEFAULT_HYPOTHESES: tuple[LoadHypothesis, ...] = (
    *(SmoothField(amplitude) for amplitude in FIELD_AMPLITUDES),
    RigidBottom(),
    Concentrated(),
    TwoParts(),
    Ring(),
    UniformParts(),
    NamedMaterials(),
)
"""The hypotheses that `identify` weighs unless it is told others."""


def check_names(hypotheses: Sequence[LoadHypothesis]) -> None:
    """Raises IdentificationError: two hypotheses have the same name."""
    names = [one.name for one in hypotheses]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise IdentificationError(
            f"hypotheses: two are named {twice!r}; expected a name of its own for each"
        )


def name_priors(
    hypothesis: LoadHypothesis, inputs: HypothesisInputs
) -> list[tuple[str, LoadPrior]]:
    """The priors that a hypothesis proposes, each with a name."""
    priors = list(hypothesis.propose(inputs))
    if len(priors) == 1:
        return [(hypothesis.name, priors[0])]
    return [(f"{hypothesis.name} {i + 1}", prior) for i, prior in enumerate(priors)]


def sort_fields(hypotheses: Sequence[LoadHypothesis]) -> list[LoadHypothesis]:
    """Sorts the smooth fields among hypotheses by increasing amplitude."""
    fields = [one for one in hypotheses if one.field_amplitude is not None]
    return sorted(fields, key=lambda one: one.field_amplitude or 0.0)
