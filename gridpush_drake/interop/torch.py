"""Pushes in torch: `simulate` with `backward`, `gradcheck` and `torch.func`.

    pip install '.[torch]'

The simulation runs in this package's compiled kernels on the CPU; the derivatives are their exact
Jacobian. Second derivatives are not there. All numbers are `torch.float64`.
"""

from typing import Any

from gridpush_drake.extras import import_extra
from gridpush_drake.interop.differentiable import PushFunction, PushSetting
from gridpush_drake.objects.grid_object import GridObject

torch = import_extra("torch", "torch")

__all__ = ["PushSetting", "simulate"]


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

    Every tensor may require gradients, be batched by `torch.func.vmap`, or have leading dimensions
    of its own, which broadcast.

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
        (3,) float64, the object's last pose, or (steps + 1, 3) all of them with `setting.path`.

    Raises:
        SimulationError: a shape or a number will not do.
    """
    function = PushFunction(obj, setting)
    given = (mass, friction, contact_friction, start, velocity, pose)
    values = [_make_tensor(value) for value in function.fill_defaults(given)]
    function.check_shapes([tuple(value.shape) for value in values])
    poses, *_ = _Simulate.apply(function, *values)
    return poses


def _make_tensor(value: Any) -> Any:
    """A tensor as it is, anything else as a copy, as torch wants arrays it can write to."""
    if isinstance(value, torch.Tensor):
        return value.to(torch.float64)
    return torch.tensor(value, dtype=torch.float64)


class _Simulate(torch.autograd.Function):  # type: ignore[name-defined]
    """The push, its blocks of derivatives beside it; only the poses are differentiable."""

    @staticmethod
    def forward(function: PushFunction, *values: Any) -> tuple[Any, ...]:
        """Simulates and differentiates."""
        arrays = [value.detach().cpu().numpy() for value in values]
        poses, blocks = function.differentiate(*arrays)
        return tuple(torch.from_numpy(array.copy()) for array in (poses, *blocks))

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: tuple[Any, ...]) -> None:
        """Keeps the blocks for the way back and for the way forward."""
        function, *values = inputs
        _, *blocks = output
        ctx.function = function
        ctx.shapes = [tuple(value.shape) for value in values]
        ctx.mark_non_differentiable(*blocks)
        ctx.save_for_backward(*blocks)
        ctx.save_for_forward(*blocks)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, cotangent: Any, *_: Any) -> tuple[Any, ...]:
        """The gradient by each argument: its block's transpose times the result's."""
        results = len(ctx.function.output_shape)
        gradients = []
        for block, shape, own in zip(
            ctx.saved_tensors, ctx.shapes, ctx.function.shapes, strict=True
        ):
            # One dimension for each of the argument's own, behind those of the result.
            spread = cotangent[(..., *(None,) * len(own))]
            first = block.ndim - len(own) - results
            places = tuple(range(first, first + results))
            gradient = (block * spread).sum(dim=places)
            # What was broadcast on the way there is summed on the way back.
            gradients.append(gradient.sum_to_size(shape))
        return (None, *gradients)

    @staticmethod
    def jvp(ctx: Any, _: Any, *tangents: Any) -> tuple[Any, ...]:
        """The change of the poses: each block times the change of its argument."""
        results = len(ctx.function.output_shape)
        change: Any = 0.0
        for block, tangent, own in zip(
            ctx.saved_tensors, tangents, ctx.function.shapes, strict=True
        ):
            if tangent is None:
                continue
            # The result's dimensions stand between the leading ones and the argument's own.
            leading = (slice(None),) * (tangent.ndim - len(own))
            product = block * tangent[(*leading, *(None,) * results, ...)]
            if own:
                product = product.sum(dim=tuple(range(-len(own), 0)))
            change = change + product
        return (change, *(None,) * len(ctx.saved_tensors))

    @staticmethod
    def vmap(info: Any, in_dims: tuple[Any, ...], function: PushFunction, *values: Any) -> Any:
        """Simulates a batch, which is one more leading dimension."""
        # The batch in front of every argument; with a size of 1 where it is not batched.
        fronts = []
        for value, dim in zip(values, in_dims[1:], strict=True):
            fronts.append(value.unsqueeze(0) if dim is None else value.movedim(dim, 0))
        # All arguments get equally many leading dimensions behind it, so that they broadcast.
        leading = []
        for front, own in zip(fronts, function.shapes, strict=True):
            leading.append(front.ndim - len(own))
        batched = []
        for front, count in zip(fronts, leading, strict=True):
            missing = (1,) * (max(leading) - count)
            batched.append(front.reshape(front.shape[:1] + missing + front.shape[1:]))
        outputs = _Simulate.apply(function, *batched)
        return outputs, (0,) * len(outputs)
