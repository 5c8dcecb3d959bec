"""Trains a small policy through the simulator: from where an object lies to a push that brings it to the origin."""

import jax
import numpy as np
import optax

jax.config.update("jax_enable_x64", True)

from gridpush_drake import GridObject  # noqa: E402
from gridpush_drake.interop.jax import PushSetting, simulate  # noqa: E402
from gridpush_drake.objects import find_shipped_object  # noqa: E402

obj = GridObject.from_yaml(find_shipped_object("open_book"))
left, low, _, high = obj.outline.bounds
setting = PushSetting(duration=1.0, radius=0.006, steps=40)


def choose_push(weights, pose):
    """Where on the object's left side the finger begins, and how fast it goes, by two small layers."""
    hidden = jax.numpy.tanh(weights["in"] @ jax.numpy.append(10 * pose, 1.0))
    place, speed, aside = weights["out"] @ hidden
    y = 0.35 * (high - low) * jax.numpy.tanh(place)
    c, s = jax.numpy.cos(pose[2]), jax.numpy.sin(pose[2])
    R = jax.numpy.array([[c, -s], [s, c]])
    start = pose[:2] + R @ jax.numpy.array([left - 0.008, y])
    return start, R @ jax.numpy.array([0.05 * jax.numpy.exp(speed), 0.02 * jax.numpy.tanh(aside)])


def push(weights, pose):
    """The object's pose after the push that the policy chooses."""
    start, velocity = choose_push(weights, pose)
    return simulate(obj, setting, start=start, velocity=velocity, pose=pose)


def calc_loss(weights, poses):
    """Mean squared distance from the origin, cm², a turn counted by the way of the cells."""
    ends = jax.vmap(push, (None, 0))(weights, poses)
    return 1e4 * ((ends * np.array([1, 1, obj.radius_of_gyration])) ** 2).sum(axis=1).mean()


rng = np.random.default_rng(0)
weights = {"in": rng.normal(0, 0.3, (16, 4)), "out": rng.normal(0, 0.1, (3, 16))}
optimizer = optax.adam(0.02)
state = optimizer.init(weights)
step = jax.jit(jax.value_and_grad(calc_loss))
losses = []
for _ in range(80):
    poses = rng.normal((-0.06, 0.0, 0.0), (0.01, 0.01, 0.2), (8, 3))
    loss, gradient = step(weights, poses)
    updates, state = optimizer.update(gradient, state)
    weights = optax.apply_updates(weights, updates)
    losses.append(float(loss))

print(
    f"Distance from the origin, root mean square: {np.mean(losses[:5]) ** 0.5:.2f} cm before, "
    f"{np.mean(losses[-5:]) ** 0.5:.2f} cm after."
)
