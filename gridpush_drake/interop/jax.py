"""Pushes in JAX: `simulate` with `grad`, `jacfwd`, `jacrev`, `vmap` and `jit`.

    pip install '.[jax]'

The simulation runs in this package's compiled kernels, which JAX calls back; the derivatives are
their exact Jacobian, not JAX's. Second derivatives are not there. All numbers are 64-bit: call
`jax.config.update("jax_enable_x64", True)` first.
"""

from typing import Any

from gridpush_drake.errors import SimulationError
from gridpush_drake.extras import import_extra
from gridpush_drake.interop.differentiable import ARGUMENT_NAMES, PushFunction, PushSetting
from gridpush_drake.objects.grid_object import GridObject

jax = import_extra("jax", "jax")

__all__ = ["PushSetting", "simulate"]

BATCHING_METHOD = "expand_dims"
"""How JAX hands a batch to the callback: what is not batched comes once, with dimensions of 1."""


def simulate(
    obj: GridObject,
    setting: PushSetting,
    *,
    start: Any,
    velocity: Any,
    mass: Any = None,
    friction: Any = None,
    contact_friction: Any = None,
    pose: Any = None,
) -> Any:
    """Simulates a straight push, differentiably.

    Every array may be traced, differentiated or batched by JAX's transformations, or have equal
    leading dimensions of its own, which broadcast.

    Args:
        obj: the object.
        setting: duration, number of steps, physics: what is not differentiated.
        start: (2,) p_WP of the pusher's center at the beginning, m.
        velocity: (2,) of the pusher, m/s, not zero.
        mass: (n,) of the cells, kg; by default the prior's.
        friction: (n,) of the cells; by default the prior's.
        contact_friction: () of the pusher; by default the prior's.
        pose: (3,) of the object at the beginning, m and rad; by default zeros.

    Returns:
        (3,) the object's last pose, or (steps + 1, 3) all of them with `setting.path`.

    Raises:
        SimulationError: a shape will not do, or JAX's 64-bit numbers are off. What is wrong with
            the numbers themselves is found while the function runs, and JAX wraps that error into
            one of its own.
    """
    if not jax.config.jax_enable_x64:
        raise SimulationError(
            "jax: 64-bit numbers are off; expected jax.config.update('jax_enable_x64', True) "
            "before the first array is made"
        )
    function = PushFunction(obj, setting)
    given = (mass, friction, contact_friction, start, velocity, pose)
    values = [
        jax.numpy.asarray(value, dtype=jax.numpy.float64) for value in function.fill_defaults(given)
    ]
    function.check_shapes([value.shape for value in values])
    leading = jax.numpy.broadcast_shapes(
        *(
            value.shape[: value.ndim - len(shape)]
            for value, shape in zip(values, function.shapes, strict=True)
        )
    )
    return _make_differentiable(function, leading)(*values)


def _make_differentiable(function: PushFunction, leading: tuple[int, ...]) -> Any:
    """The function with its own rule of differentiation, for arrays with leading dimensions."""
    output = leading + function.output_shape

    # Without derivatives: the poses alone, which are quicker.
    @jax.custom_jvp
    def run(*values: Any) -> Any:
        return jax.pure_callback(
            function.calc_poses, _describe(output), *values, vmap_method=BATCHING_METHOD
        )

    # Forward: the change of the poses is linear in the tangents. So JAX can also transpose it,
    # which gives the reverse mode from the same blocks.
    @run.defjvp
    def differentiate(primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[Any, Any]:
        shapes = [_describe(output + shape) for shape in function.shapes]
        poses, blocks = jax.pure_callback(
            function.differentiate,
            (_describe(output), shapes),
            *primals,
            vmap_method=BATCHING_METHOD,
        )
        change = sum(
            _apply(block, tangent, len(shape), len(function.output_shape))
            for block, tangent, shape in zip(blocks, tangents, function.shapes, strict=True)
        )
        return poses, change

    assert len(ARGUMENT_NAMES) == len(function.shapes)
    return run


def _describe(shape: tuple[int, ...]) -> Any:
    return jax.ShapeDtypeStruct(shape, jax.numpy.float64)


def _apply(block: Any, tangent: Any, of_argument: int, of_result: int) -> Any:
    """The change of the result, block times tangent, whose leading dimensions broadcast."""
    # The result's dimensions stand between the leading ones and the argument's own.
    inserted = tuple(range(tangent.ndim - of_argument, tangent.ndim - of_argument + of_result))
    spread = jax.numpy.expand_dims(tangent, inserted)
    last = tuple(range(block.ndim - of_argument, block.ndim))
    return (block * spread).sum(axis=last)
