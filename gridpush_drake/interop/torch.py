"""Pushes in torch: `simulate` as a differentiable function, with `backward`, `gradcheck` and `torch.func`.

    pip install 'gridpush-drake[torch]'

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
    """A tensor as it is, anything else as a copy: torch wants no arrays that cannot be written to."""
    if isinstance(value, torch.Tensor):
        return value.to(torch.float64)
    return torch.tensor(value, dtype=torch.float64)


class _Simulate(torch.autograd.Function):  # type: ignore[misc, name-defined]
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
            spread = cotangent[(..., *(None,) * len(own))]
            at = block.ndim - len(own) - results
            gradient = (block * spread).sum(dim=tuple(range(at, at + results)))
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
            leading = tangent.ndim - len(own)
            inserted = (slice(None),) * leading + (None,) * results
            product = block * tangent[(*inserted, ...)]
            change = change + (product.sum(dim=tuple(range(-len(own), 0))) if own else product)
        return (change, *(None,) * len(ctx.saved_tensors))

    @staticmethod
    def vmap(info: Any, in_dims: tuple[Any, ...], function: PushFunction, *values: Any) -> Any:
        """A batch is one more leading dimension; what is not batched has it with a size of 1."""
        batched = []
        for value, dim, own in zip(values, in_dims[1:], function.shapes, strict=True):
            front = value.unsqueeze(0) if dim is None else value.movedim(dim, 0)
            # so that the leading dimensions of all arguments are as many, and broadcast
            most = max(
                v.ndim - len(s) - (d is not None)
                for v, d, s in zip(values, in_dims[1:], function.shapes, strict=True)
            )
            missing = most + 1 - (front.ndim - len(own))
            batched.append(front.reshape(front.shape[:1] + (1,) * missing + front.shape[1:]))
        outputs = _Simulate.apply(function, *batched)
        if outputs[0].shape[0] != info.batch_size:
            outputs = tuple(each.expand(info.batch_size, *each.shape[1:]) for each in outputs)
        return outputs, (0,) * len(outputs)
