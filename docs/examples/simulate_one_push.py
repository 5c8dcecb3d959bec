"""Simulates one push of a hammer, and says where it ends and what each cell's mass has to do with it."""

import numpy as np

from gridpush_drake import CellParameters, GridObject, Model, Push
from gridpush_drake.objects import find_shipped_object

# A hammer whose head (part 2) is four times as heavy, cell for cell, as its handle (part 1)
hammer = GridObject.from_yaml(find_shipped_object("claw_hammer"))
params = CellParameters.by_part(hammer, mass={1: 0.005, 2: 0.02}, friction=0.35)

# A finger of 6 mm radius goes straight towards the outline, 5 cm in one second
push = Push.on_outline(hammer, 0.1, angle=0.0, distance=0.05, radius=0.006, duration=1.0)
motion = Model(hammer, params).simulate(push, gradients=True)

x, y, theta = motion.final_pose
print(
    f"The hammer ends at ({1e3 * x:.1f}, {1e3 * y:.1f}) mm, turned by {np.degrees(theta):.1f} degrees."
)
print(
    f"The finger presses with up to {np.linalg.norm(motion.contact_forces.sum(1), axis=1).max():.2f} N."
)

# The exact derivative of the last turn by each cell's mass
by_mass = motion.jacobian.mass[-1, 2]
strongest = int(np.abs(by_mass).argmax())
turn = np.degrees(1e-3 * by_mass[strongest])
print(f"One more gram in cell {strongest} changes the turn by {turn:.2g} degrees.")
