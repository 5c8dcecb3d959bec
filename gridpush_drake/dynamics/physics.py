"""`Physics`: how objects slide, said once, in one value that everything passes on.

A law of support friction, a regime, a spin model, gravity and the tolerances of the step. The same
value goes into `simulate`, `identify`, `predict`, the planners and `GridLcpSystem`, and a learned
model remembers the one that it was learned with. What one object weighs and how rough it is stands
in `CellParameters`; how finely a push is cut into steps is said with each push.

`docs/theory/model.md` has the laws (section 3), the regimes (section 4) and the smoothing.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from gridpush_drake.dynamics.kernels.friction.friction_law import SPIN_MODELS, FrictionLaw
from gridpush_drake.dynamics.kernels.friction.laws import FRICTION_LAWS
from gridpush_drake.errors import SimulationError
from gridpush_drake.objects.grid_object import GridObject

Regime = Literal["auto", "inertial", "quasi_static"]
"""Whether masses act. "inertial": they do. "quasi_static": the limit of slow pushes, where only the
cells' fractions of the friction matter. "auto": whichever of the two suits the push's speed."""

SpinModel = Literal["coupled", "separate", "none"]
"""How the cells resist spinning, see `kernels.isotropic_friction`."""

REGIME_NAMES: tuple[Regime, ...] = ("auto", "inertial", "quasi_static")
"""Every word for a regime."""

GRAVITY = 9.81
"""Acceleration of gravity, m/s²."""

FAST_PUSH = 0.01
"""A push is fast, and is simulated with inertia, if v²/(mu g rho) is more than this. v is its mean
speed, mu the friction with the table and rho the object's radius of gyration: the number compares
the object's kinetic energy with the work of friction over a distance rho."""

STICTION_TOLERANCE = 1e-9
"""Speed below which friction is smoothed in the inertial regime, m/s. A body at rest creeps slower
than a few of these."""

MIN_STICTION_TOLERANCE = 1e-15
"""Least stiction tolerance, m/s. Below it, rounding errors decide what moves."""

RELATIVE_STICTION_TOLERANCE = 1e-7
"""Least stiction tolerance of either regime, as a fraction of the speed of pusher and body."""

MIDPOINT_FRACTION = 0.5
"""Fraction of a step after which the midpoint rule looks at the body."""


def check_word(name: str, value: object, known: tuple[object, ...]) -> None:
    """Raises SimulationError if a word is not among those known."""
    if value not in known:
        words = ", ".join(map(repr, known))
        raise SimulationError(f"{name} is {value!r}; expected one of {words}")


def check_number(name: str, value: float, least: float) -> None:
    """Raises SimulationError for what is not a finite number of at least `least`."""
    if not (np.isfinite(value) and value >= least):
        raise SimulationError(f"{name} is {value!r}; expected a finite number >= {least:g}")


@dataclass(frozen=True)
class Physics:
    """How objects slide.

    Attributes:
        friction_law: name of the law of support friction, one of `kernels.LAWS`: "isotropic" (exact
            at the transition from stick to slip), "lagged" (the paper's LCP, whose friction
            directions are those of the step before), or one that you registered by
            `register_friction_law`.
        regime: "inertial", "quasi_static", or "auto", which `resolve` replaces.
        spin: how the cells resist spinning. A law that does not know this model uses the first of
            its own; "lagged" is always "separate".
        gravity: m/s².
        stiction_tolerance: speed below which friction is smoothed, m/s; inertial regime only.
        relative_stiction_tolerance: the least tolerance in either regime, as a fraction of the
            speed of pusher and body.

    Raises:
        SimulationError: a word is not known, a number is out of range, or the law does not know the
            regime.
    """

    friction_law: str = "isotropic"
    regime: Regime = "auto"
    spin: SpinModel = "coupled"
    gravity: float = GRAVITY
    stiction_tolerance: float = STICTION_TOLERANCE
    relative_stiction_tolerance: float = RELATIVE_STICTION_TOLERANCE

    def __post_init__(self) -> None:
        if self.friction_law not in FRICTION_LAWS:
            known_laws = ", ".join(map(repr, FRICTION_LAWS))
            raise SimulationError(
                f"friction_law is {self.friction_law!r}; expected one of {known_laws}, "
                "or a law of your own once register_friction_law has made it known"
            )
        check_word("regime", self.regime, REGIME_NAMES)
        check_word("spin", self.spin, SPIN_MODELS)
        check_number("gravity", self.gravity, 0.0)
        check_number("stiction_tolerance", self.stiction_tolerance, MIN_STICTION_TOLERANCE)
        check_number(
            "relative_stiction_tolerance", self.relative_stiction_tolerance, MIN_STICTION_TOLERANCE
        )
        known = self.law.regimes
        if self.regime != "auto" and self.regime not in known:
            raise SimulationError(
                f"friction_law: {self.friction_law!r} needs the regime "
                f"{' or '.join(map(repr, known))}"
            )

    @property
    def law(self) -> FrictionLaw:
        """The law of support friction."""
        return FRICTION_LAWS[self.friction_law]

    @property
    def used_spin(self) -> str:
        """The spin model that the law uses."""
        return self.law.choose_spin(self.spin)

    @property
    def inertial(self) -> bool:
        """Whether masses act.

        Raises:
            SimulationError: the regime is still "auto".
        """
        if self.regime == "auto":
            raise SimulationError("regime is 'auto'; expected one that `Physics.resolve` chose")
        return self.regime == "inertial"

    @property
    def ahead(self) -> float:
        """Fraction of a step after which it looks at the body; 0.5 by the midpoint rule."""
        return MIDPOINT_FRACTION if self.law.looks_ahead else 0.0

    def check_gradients(self, gradients: bool | str, asked: bool | str) -> None:
        """Refuses gradients that the friction law does not have.

        Args:
            gradients: the value of `simulate`'s argument that the law must know.
            asked: the value that was given.

        Raises:
            SimulationError: the law does not know them.
        """
        known = self.law.gradients
        if gradients not in known:
            words = ", ".join(map(repr, known))
            raise SimulationError(
                f"gradients is {asked!r}; "
                f"with friction_law={self.friction_law!r} expected one of {words}"
            )

    def with_regime(self, regime: Regime | None) -> "Physics":
        """Replaces the regime; None leaves it as it is."""
        return self if regime in (None, self.regime) else replace(self, regime=regime)

    def resolve(self, obj: GridObject, friction: float, speed: float) -> "Physics":
        """Replaces "auto" by the regime that suits pushes of a given speed.

        Args:
            obj: the object that is pushed.
            friction: mean coefficient of its friction with the table.
            speed: mean speed of the fastest push, m/s.

        Returns:
            The same physics, "inertial" for fast pushes (see `FAST_PUSH`) and on a table without
            friction, "quasi_static" otherwise; where the law knows one regime only, that one. A
            regime other than "auto" stays.
        """
        if self.regime != "auto":
            return self
        slow = speed**2 <= FAST_PUSH * friction * self.gravity * obj.radius_of_gyration
        chosen: Regime = "quasi_static" if slow and friction * self.gravity > 0 else "inertial"
        known = self.law.regimes
        return replace(self, regime=chosen if chosen in known else known[0])


DEFAULT_PHYSICS = Physics()
"""The physics of a call that is given none: isotropic friction, the regime by the push's speed."""

QUASI_STATIC = Physics(regime="quasi_static")
"""The default physics of pushes that are slow enough to end at rest."""


def make_physics(physics: Physics | None, regime: Regime | None) -> Physics:
    """Reads the two arguments by which a public function takes physics.

    Args:
        physics: the physics; the default ones if None.
        regime: takes the place of the regime in `physics`, unless None.

    Returns:
        The physics; the regime may still be "auto".

    Raises:
        SimulationError: the regime is no known word, or the law does not know it.
    """
    return (physics or DEFAULT_PHYSICS).with_regime(regime)
