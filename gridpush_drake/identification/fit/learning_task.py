"""What a method of learning is: it takes a `LearningTask`, and gives back what it has `Found`.

`learning.identify` screens a log into a task, hands it to a `LearningMethod`, judges what comes
back, and reports it. A method says itself what it can do (`Abilities`). The table of all methods is
in `methods`; what can be asked of none of them is refused there.
"""

from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from gridpush_drake.errors import IdentificationError
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.absolute.estimate import AbsoluteEstimate
from gridpush_drake.identification.fit.flipped_poses import FlippedPoses
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.result import FitStart, Identification, Progress
from gridpush_drake.identification.statistics.friction_gradient import (
    HeldFriction,
    calc_gradient_std,
)
from gridpush_drake.identification.statistics.noise import NoiseModel
from gridpush_drake.identification.statistics.outliers import ScreenedLog
from gridpush_drake.identification.statistics.problem import PushProblem, make_even_parameters
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.pushes.weighings import MassTestLog


@dataclass(frozen=True)
class Abilities:
    """What a method can do, and what it needs.

    Attributes:
        needs_gradients: whether the friction law must have exact gradients.
        takes_overhang: whether it learns from pushes during which a part of the object hung over
            the table's edge. Other methods do without these pushes.
        holds_friction: whether frictions that weighings tell can be held.
        takes_budget: whether it simulates pushes until a budget is used up. Other methods end by
            themselves.
        takes_several: whether it learns several objects together.
        fits_frame: whether it finds where the outline is in the frame of the logged poses.
    """

    needs_gradients: bool = False
    takes_overhang: bool = False
    holds_friction: bool = False
    takes_budget: bool = False
    takes_several: bool = False
    fits_frame: bool = False


class LearningMethod(Protocol):
    """A method of learning.

    Attributes:
        name: its name, which the model bears that it has found.
        abilities: what it can do, and what it needs.
    """

    @property
    def name(self) -> str:
        """Its name, which the model bears that it has found."""
        ...

    @property
    def abilities(self) -> Abilities:
        """What it can do, and what it needs."""
        ...

    def learn(self, task: "LearningTask") -> "Found":
        """Learns from a task that asks for nothing but what the method can do."""
        ...


@dataclass(frozen=True, eq=False)
class LearningTask:
    """What is to be learned from: the objects, and the pushes that may be believed.

    Attributes:
        method: how it is learned from.
        model: the objects, with what their `prior` says of them, and the physics of the
            simulations. Its masses and frictions are not used.
        screened: the pushes, without the poses that jump.
        seed: seed of everything random.
        budget: largest number of pushes that a search simulates; None for its usual one.
        progress: called now and then with the best model so far; None for nobody.
        starts: where fits of the same objects to fewer pushes ended; empty to begin anew.
        friction: frictions that are held; None for the prior's.
        weighings: tilt tests and lifts of the object.
        fit_frame: whether the outline's place in the frame of the logged poses is to be learned.
    """

    method: LearningMethod
    model: Model
    screened: ScreenedLog
    seed: int = 0
    budget: int | None = None
    progress: Progress | None = None
    starts: tuple[FitStart, ...] = ()
    friction: HeldFriction | None = None
    weighings: MassTestLog = field(default_factory=MassTestLog)
    fit_frame: bool = False

    @property
    def obj(self) -> GridObject:
        """The object; there must be one alone."""
        return self.model.obj

    def move(self, obj: GridObject) -> "LearningTask":
        """Returns the task with the object at another place in the frame of the logged poses."""
        return replace(self, model=replace(self.model, objects=(obj,)))

    def hold(self, friction: HeldFriction, starts: tuple[FitStart, ...]) -> "LearningTask":
        """Returns the task with frictions held, to be begun where other fits have ended."""
        return replace(self, friction=friction, starts=starts)

    def adapt_noise(self, noise: NoiseModel) -> NoiseModel:
        """Tells a noise model how much the friction may change along the object."""
        if self.friction is not None:
            return replace(noise, friction_gradient=self.friction.gradient_std)
        return replace(noise, friction_gradient=calc_gradient_std(self.obj.prior))


class TouchingPushes:
    """The pushes of a task that touch its one object, and the unknowns that are fitted to them.

    A push that misses the object says nothing of its loads, and has no derivatives to fit with.

    Attributes:
        even: parameters of the same load everywhere, with which a fit begins.
        z0: (n+1,) the unknowns of these, the prior mean of z (section 3 of the theory).
        log_contact_friction_std: prior standard deviation of log mu_c.
        screened: the pushes that touch.
        unused: names of those that miss.
        problem: the least-squares problem of the pushes that touch.
    """

    def __init__(self, task: LearningTask, patch_ratio: float) -> None:
        """Simulates every push of a task once, to see whether it touches.

        Args:
            task: the task.
            patch_ratio: on what part of its side a cell bears its load.
        """
        obj = task.obj
        self.even = replace(make_even_parameters(obj), patch_ratio=patch_ratio)
        if task.friction is not None:
            self.even = _hold_friction(self.even, task.friction.coefficients)
        # The prior is told of mu_c, while the unknown is log mu_c: d(log mu_c) = d(mu_c) / mu_c.
        self.log_contact_friction_std = obj.prior.contact_friction_std / self.even.contact_friction
        log = task.screened.log
        everything = PushProblem(obj, log, self.even, task.model.physics)
        self.z0 = everything.unknowns(self.even)
        # Without a push nothing is simulated, and no kernel is compiled for it.
        touched = everything.touched(self.z0) if len(log) else np.empty(0, dtype=bool)
        self.unused = tuple(push.name for push, hit in zip(log, touched, strict=True) if not hit)
        self.screened = task.screened.keep(log.subset(np.flatnonzero(touched)))
        self.problem = PushProblem(obj, self.screened.log, self.even, task.model.physics)


def _hold_friction(even: CellParameters, friction: Array) -> CellParameters:
    """Gives parameters other friction coefficients, and masses that leave their loads as before.

    Args:
        even: the parameters.
        friction: (n,) the coefficients.
    """
    coefficients = np.asarray(friction, dtype=np.float64)
    good = np.isfinite(coefficients) & (coefficients > 0)
    if coefficients.shape != even.friction.shape or not good.all():
        raise IdentificationError(
            f"friction is {friction!r}; expected {even.n} positive numbers, one for each cell"
        )
    # k_i = mu_i m_i stay as they are.
    return replace(even, friction=coefficients, mass=even.mass * even.friction / coefficients)


@dataclass(frozen=True, eq=False)
class Found:
    """What a method has found, in numbers, before it is judged.

    Attributes:
        model: what was learned: an `Identification`, which has no `message` yet, or of several
            objects a `JointIdentification`.
        screened: the pushes that it was learned from, and what was refused.
        flipped: pushes whose poses are a turn of a symmetric outline off; None where none are.
        search_end: how a search ended, in a word or two; None for a fit, which ends by itself.
        estimate: mass, center of mass and friction by weighings; None where there are none.
    """

    model: Model
    screened: ScreenedLog
    flipped: FlippedPoses | None = None
    search_end: str | None = None
    estimate: AbsoluteEstimate | None = None

    @property
    def alone(self) -> Identification:
        """The model of the object; there must be one alone."""
        assert isinstance(self.model, Identification)
        return self.model
