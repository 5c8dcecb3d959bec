"""Learns where an object's mass is from twelve pushes, by gradients through the simulator and Adam of optax."""

import jax
import numpy as np
import optax

jax.config.update("jax_enable_x64", True)

from gridpush_drake import CellParameters, GridObject, Push  # noqa: E402
from gridpush_drake.interop.jax import PushSetting, simulate  # noqa: E402
from gridpush_drake.objects import find_shipped_object  # noqa: E402

# A hammer whose head is heavy, and twelve pushes of it from all sides
obj = GridObject.from_yaml(find_shipped_object("claw_hammer"))
truth = CellParameters.random(obj, seed=2, mass_range=(0.005, 0.05))
places = np.linspace(0.0, obj.outline.length, 12, endpoint=False)
pushes = [Push.on_outline(obj, s, 0.0, 0.04, radius=0.006, duration=1.0) for s in places]
start = np.array([push.start for push in pushes])
velocity = np.array([push.velocity for push in pushes])
setting = PushSetting(duration=1.0, radius=0.006, steps=40)
scale = np.array([1.0, 1.0, obj.radius_of_gyration])  # a turn counts by the way of the cells


def push_all(mass):
    """The last poses of the twelve pushes."""
    return simulate(obj, setting, start=start, velocity=velocity, mass=mass)


seen = push_all(truth.mass)


def calc_loss(log_mass):
    """Mean squared distance of the last poses from those that were seen, mm²."""
    return 1e6 * (((push_all(jax.numpy.exp(log_mass)) - seen) * scale) ** 2).sum(axis=-1).mean()


log_mass = jax.numpy.full(obj.n, np.log(truth.total_mass / obj.n))
optimizer = optax.adam(0.1)
state = optimizer.init(log_mass)
step = jax.jit(jax.value_and_grad(calc_loss))
losses = []
for _ in range(60):
    loss, gradient = step(log_mass)
    updates, state = optimizer.update(gradient, state)
    log_mass = optax.apply_updates(log_mass, updates)
    losses.append(float(loss))

fraction = np.exp(log_mass) / np.exp(log_mass).sum()
miss = np.linalg.norm(fraction @ obj.p_BC - truth.center_of_mass(obj))
print(
    f"Root of the mean squared miss: {losses[0] ** 0.5:.2f} mm before, {losses[-1] ** 0.5:.2f} mm after."
)
print(f"The center of mass is {1e3 * miss:.1f} mm off.")
