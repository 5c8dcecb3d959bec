"""Drake linearizes a pushed object, and its linear-quadratic regulator keeps that on its way."""

import numpy as np
from pydrake.systems.controllers import DiscreteTimeLinearQuadraticRegulator
from pydrake.systems.primitives import FirstOrderTaylorApproximation

from gridpush_drake import GridObject, Model
from gridpush_drake.systems import GridLcpStep

side = [[-0.05, -0.05], [0.05, -0.05], [0.05, 0.05], [-0.05, 0.05]]
box = GridObject.from_outline(side, max_cells=64)
dt, speed, radius = 0.05, 0.04, 0.006

# A finger pushes the middle of the left side along x
step = GridLcpStep(Model(box), dt, pusher_radius=radius)
nominal = np.array([-0.05 - radius, 0.0, speed, 0.0])


def take_step(q, finger):
    """The box's pose after a step from q with the finger's place and velocity (4,)."""
    context = step.CreateDefaultContext()
    step.SetPose(context, q)
    step.GetInputPort("pusher_state").FixValue(context, finger)
    return np.array(step.EvalUniquePeriodicDiscreteUpdate(context).value())


# What is regulated: y and theta of the box, by where across the side the finger pushes and how
# fast it moves aside
context = step.CreateDefaultContext()
step.GetInputPort("pusher_state").FixValue(context, nominal)
linear = FirstOrderTaylorApproximation(step, context)
A, B = linear.A()[1:, 1:], linear.B()[1:, [1, 3]]
K, _ = DiscreteTimeLinearQuadraticRegulator(A, B, np.diag([1e4, 100.0]), np.diag([1e4, 1e4]))
print(f"A =\n{np.round(A, 3)}\nB =\n{np.round(B, 3)}")


def drive(regulated):
    """Where a box ends that begins aside and askew, pushed for three seconds."""
    q = np.array([0.0, 0.004, 0.1])
    for _ in range(60):
        across, aside = -K @ q[1:] if regulated else (0.0, 0.0)
        # the finger touches the left side, wherever that is now
        slope = np.tan(q[2])
        x = q[0] - (0.05 + radius) / np.cos(q[2]) - slope * (across - q[1])
        q = take_step(q, [x, across, speed, np.clip(aside, -0.02, 0.02)])
    return q


for regulated in (False, True):
    x, y, theta = drive(regulated)
    print(
        f"{'With' if regulated else 'Without'} the regulator: {1e3 * y:.1f} mm aside and "
        f"{np.degrees(theta):.1f} degrees askew after {100 * x:.0f} cm."
    )
