"""What a law of support friction is: one object, in one file, with all that the solver asks of it.

With xi = (ux, uy, w) the twist of the body in its own frame and k_i = mu_i m_i g the friction that
cell i can carry, a law is a dissipation Psi(xi; k), convex in xi, smoothed below the stiction
tolerance eps, and its derivatives:

    Psi,    g = dPsi/dxi,    H = d²Psi/dxi²,    f_i = dg/dk_i

A new law is a file like `isotropic_friction` that ends with its `FrictionLaw`, and one line that
registers it: `register_friction_law(...)`. The kernels are then compiled for it on its
first use. `docs/extending.md` has a whole one.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import asinh, sqrt
from typing import Any, Literal

from gridpush_drake.dynamics.kernels.compiled import kernel
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters

SPIN_LEVER_ARM = (sqrt(2) + asinh(1)) / 6
"""c: mean distance of a unit square's points from its center."""

SPIN_MODELS = ("coupled", "separate", "none")
"""How the cells may resist spinning, see `isotropic_friction`."""


def calc_spin_lever_arm(obj: GridObject, params: CellParameters) -> float:
    """Calculates how far the points that bear a cell's load are from its center on average: c s, m.

    s is the side of the patch that they fill.
    """
    return SPIN_LEVER_ARM * params.patch_ratio * obj.cell_size


@kernel(allocates=False, inlined=True)
def _remember_nothing(law):
    """Begins a push of a law that remembers nothing from step to step."""


@dataclass(frozen=True)
class FrictionLaw:
    """A law of support friction.

    The functions are kernels, or `make` apart, NumPy; `law` is what `make` made, `cells` (2, n) the
    cell centers p_BC in m, `xi` (3,) the twist in m/s and rad/s; in the quasi-static regime per
    meter of the pusher's path, which tells no speed.

    Attributes:
        name: the word by which `Physics.friction_law` names it.
        data: the class of `law`, a named tuple of arrays and numbers, no other law's.
        make: (k, arm, spin) -> law, of k (n,) in N, arm = `calc_spin_lever_arm` in m, and a spin
            model.
        renew: (law): takes notice that its k changed.
        begin_step: (law, cells, com_x, com_y, cell_size, expected_velocity, force_acceleration,
            known): looks at the motion before the step, (3,) m/s and rad/s, and at the acceleration
            that the applied force alone would give the body, (3,) m/s² and rad/s², both of the
            center of mass; `known` says whether either tells where the body goes.
        calc_dissipation: (law, cells, eps, xi) -> Psi, W.
        add_derivatives: (law, cells, eps, xi, majorize, g, H): adds g (3,) and H (3, 3). With
            `majorize` H is that of a quadratic which touches Psi at xi from above: slower, but a
            step with it always descends.
        can_majorize: (law) -> whether there is such a quadratic; `majorize` is asked for only then.
        fill_load_derivatives: (law, cells, eps, xi, f): fills f (3, >= n) with f_i.
        spin_models: those it knows; any other word stands for the first.
        regimes: those it knows; only "inertial" where friction depends on speed.
        gradients: the values of `simulate`'s argument that it knows.
        looks_ahead: whether a step sees the body halfway through it (the midpoint rule) or where it
            begins.
        begin_push: (law): forgets what it remembers of another push, so that each push is simulated
            as by itself.
    """

    name: str
    data: type
    make: Callable[..., Any]
    renew: Callable[..., Any]
    begin_step: Callable[..., Any]
    calc_dissipation: Callable[..., Any]
    add_derivatives: Callable[..., Any]
    can_majorize: Callable[..., Any]
    fill_load_derivatives: Callable[..., Any]
    spin_models: tuple[str, ...] = SPIN_MODELS
    regimes: tuple[Literal["inertial", "quasi_static"], ...] = ("inertial", "quasi_static")
    gradients: tuple[bool | str, ...] = (False, True)
    looks_ahead: bool = True
    begin_push: Callable[..., Any] = _remember_nothing

    def choose_spin(self, spin: str) -> str:
        """The spin model that the law uses where `spin` is asked for."""
        return spin if spin in self.spin_models else self.spin_models[0]
