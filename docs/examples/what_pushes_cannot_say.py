"""Says how sure a learned model is, and what pushes of this kind can never tell."""

import numpy as np

from gridpush_drake import CellParameters, GridObject, Model, ObservedPush, Push, PushLog, identify
from gridpush_drake.objects import find_shipped_object

wrench = GridObject.from_yaml(find_shipped_object("combination_wrench"))
truth = CellParameters.random(wrench, seed=4, mass_range=(0.01, 0.04), friction_range=(0.3, 0.4))
rng = np.random.default_rng(1)


def push(name):
    """A push at a random place, seen with noise, that moves the wrench."""
    while True:
        place = rng.uniform(0, wrench.edges.perimeter)
        trial = Push.on_outline(wrench, place, 0.0, 0.05, radius=0.005, speed=0.03, clearance=0.001)
        motion = Model(wrench, truth).simulate(trial)
        if motion.status == "ok" and np.linalg.norm(motion.final_pose[:2]) > 0.01:
            rows = np.linspace(0, len(motion.times) - 1, 8).astype(int)[1:]
            seen = motion.poses[rows] + [0.0005, 0.0005, 0.003] * rng.standard_normal((7, 3))
            return ObservedPush(name, trial, np.zeros(3), motion.times[rows], seen)


log = PushLog(tuple(push(f"push_{k}") for k in range(5)), source="an example")
for count in (1, 2, 5):
    model = identify(Model(wrench), log.subset(range(count)))
    known = model.identifiability
    spread = 1e3 * np.sqrt(np.diag(known.center_of_friction_covariance))
    miss = 1e3 * np.linalg.norm(known.center_of_friction - truth.relative_friction() @ wrench.p_BC)
    print(
        f"{count} pushes: center of friction known to {spread[0]:.1f} and {spread[1]:.1f} mm; "
        f"it is {miss:.1f} mm off."
    )

# Slow pushes tell friction, not mass: the center of mass is somewhere in a box
low, high = 1e3 * np.array(model.identifiability.center_of_mass_box)
print(
    f"Without a word about frictions its x may be anywhere from {low[0]:.0f} to {high[0]:.0f} mm."
)
