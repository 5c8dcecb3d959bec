"""The laws of support friction, and the kernels' calls of them.

A kernel gets a law as a named tuple; its class decides, when the kernel is compiled, which law's
functions are called. Every law so has a solver of its own, and pays for no other.
"""

from numba import types
from numba.extending import overload

from gridpush_drake.dynamics.kernels.friction.friction_law import FrictionLaw
from gridpush_drake.dynamics.kernels.friction.isotropic_friction import ISOTROPIC_LAW
from gridpush_drake.dynamics.kernels.friction.lagged_friction import LAGGED_LAW
from gridpush_drake.dynamics.kernels.numba_internals import BORROWED_OPTIONS, get_record_class
from gridpush_drake.errors import SimulationError

FRICTION_LAWS: dict[str, FrictionLaw] = {}
"""The laws by name: those of the lines below, and those that a user registered."""

_LAW_OF_DATA: dict[type, FrictionLaw] = {}
"""The laws by the class of their data, which is what compiled code knows of a law."""


def register_friction_law(law: FrictionLaw) -> FrictionLaw:
    """Makes a law known by its name: to simulate, learn, plan and read models with.

    Registering the same law again changes nothing, so that a module that does it may be reloaded.

    Args:
        law: the law, from a module of this package or from your own.

    Returns:
        The law.

    Raises:
        SimulationError: its name is taken by another law, or its data class is another law's.
    """
    taken = FRICTION_LAWS.get(law.name)
    if taken is not None and taken.data.__qualname__ != law.data.__qualname__:
        raise SimulationError(
            f"friction law {law.name!r}: the name is taken by the law of {taken.data.__name__}; "
            "expected another name"
        )
    owner = _LAW_OF_DATA.get(law.data)
    if owner is not None and owner.name != law.name:
        raise SimulationError(
            f"friction law {law.name!r}: its data class {law.data.__name__} is that of "
            f"{owner.name!r}; expected a class of its own"
        )
    FRICTION_LAWS[law.name] = law
    _LAW_OF_DATA[law.data] = law
    return law


register_friction_law(ISOTROPIC_LAW)
register_friction_law(LAGGED_LAW)


def renew(law):
    """Lets the law take notice that its k changed, see `FrictionLaw`; compiled code only."""
    raise NotImplementedError


def begin_push(law):
    """Lets the law forget another push, see `FrictionLaw`; compiled code only."""
    raise NotImplementedError


def begin_step(law, cells, com_x, com_y, cell_size, expected_velocity, force_acceleration, known):
    """Lets the law look at the motion before a step, see `FrictionLaw`; compiled code only."""
    raise NotImplementedError


def calc_dissipation(law, cells, eps, xi):
    """Calculates Psi, see `FrictionLaw`; compiled code only."""
    raise NotImplementedError


def add_derivatives(law, cells, eps, xi, majorize, g, H):
    """Adds gradient and Hessian of Psi, see `FrictionLaw`; compiled code only."""
    raise NotImplementedError


def can_majorize(law):
    """Whether the law has a majorizing quadratic, see `FrictionLaw`; compiled code only."""
    raise NotImplementedError


def fill_load_derivatives(law, cells, eps, xi, f):
    """Fills in the gradient's derivative by every k_i, see `FrictionLaw`; compiled code only."""
    raise NotImplementedError


def _find_law(data: types.Type) -> FrictionLaw:
    """Finds a law by the type of its data."""
    record = get_record_class(data)
    assert record is not None, "a law's data are a named tuple"
    return _LAW_OF_DATA[record]


@overload(renew, jit_options=BORROWED_OPTIONS)
def _renew(law):
    call = _find_law(law).renew
    return lambda law: call(law)


@overload(begin_push, jit_options=BORROWED_OPTIONS)
def _begin_push(law):
    call = _find_law(law).begin_push
    return lambda law: call(law)


@overload(begin_step, jit_options=BORROWED_OPTIONS)
def _begin_step(law, cells, com_x, com_y, cell_size, expected_velocity, force_acceleration, known):
    call = _find_law(law).begin_step
    return (
        lambda law, cells, com_x, com_y, cell_size, expected_velocity, force_acceleration, known: (
            call(law, cells, com_x, com_y, cell_size, expected_velocity, force_acceleration, known)
        )
    )


@overload(calc_dissipation, jit_options=BORROWED_OPTIONS)
def _calc_dissipation(law, cells, eps, xi):
    call = _find_law(law).calc_dissipation
    return lambda law, cells, eps, xi: call(law, cells, eps, xi)


@overload(add_derivatives, jit_options=BORROWED_OPTIONS)
def _add_derivatives(law, cells, eps, xi, majorize, g, H):
    call = _find_law(law).add_derivatives
    return lambda law, cells, eps, xi, majorize, g, H: call(law, cells, eps, xi, majorize, g, H)


@overload(can_majorize, jit_options=BORROWED_OPTIONS)
def _can_majorize(law):
    call = _find_law(law).can_majorize
    return lambda law: call(law)


@overload(fill_load_derivatives, jit_options=BORROWED_OPTIONS)
def _fill_load_derivatives(law, cells, eps, xi, f):
    call = _find_law(law).fill_load_derivatives
    return lambda law, cells, eps, xi, f: call(law, cells, eps, xi, f)
