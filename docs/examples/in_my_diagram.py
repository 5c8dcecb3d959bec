"""A pushed object and its learner in a Drake Diagram of one's own, without any robot."""

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import MatrixGain, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from gridpush_drake import CellParameters, GridIdentifier, GridLcpSystem, GridObject, Model

plate = GridObject.from_outline(
    [[-0.07, -0.04], [0.07, -0.04], [0.07, 0.04], [-0.07, 0.04]], max_cells=40
)
mass = np.where(plate.p_BC[:, 0] > 0, 3.0, 1.0)  # its right half is heavier
truth = CellParameters(0.5 * mass / mass.sum(), np.full(plate.n, 0.35))

# The finger's tip, (x, y, z) in m at 5 cm/s: down beside the plate, a push, and up; four times
path = [(-0.2, -0.2, 0.1)]
for x, end in ((0.05, -0.02), (-0.03, 0.0), (0.03, 0.02), (0.0, 0.04)):
    path += [(x, -0.1, 0.1), (x, -0.1, 0.01), (x, end, 0.01), (x, end, 0.1), (-0.2, -0.2, 0.1)]
times = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1) / 0.05))

builder = DiagramBuilder()
way = PiecewisePolynomial.FirstOrderHold(times, np.transpose(path))
finger = builder.AddSystem(TrajectorySource(way, 1))
world = builder.AddSystem(
    GridLcpSystem(Model(plate, truth), regime="quasi_static", pusher_radius=0.006)
)
learner = builder.AddSystem(GridIdentifier(plate, pusher_radius=0.006, engaged_below=0.05))
flat = builder.AddSystem(MatrixGain(np.eye(6)[[0, 1, 3, 4]]))  # x, y and their velocities
builder.Connect(finger.get_output_port(), flat.get_input_port())
builder.Connect(flat.get_output_port(), world.GetInputPort("pusher_state"))
builder.Connect(finger.get_output_port(), learner.GetInputPort("pusher_state"))
builder.Connect(world.GetOutputPort("pose"), learner.GetInputPort("object_pose"))

simulator = Simulator(builder.Build())
simulator.AdvanceTo(times[-1])
context = learner.GetMyContextFromRoot(simulator.get_context())
center = learner.GetOutputPort("center_of_mass").Eval(context)
print(f"Pushes seen: {learner.GetOutputPort('num_pushes').Eval(context)[0]:.0f}.")
print(
    f"Center of mass: learned {np.round(1e3 * center, 1)} mm, true "
    f"{np.round(1e3 * truth.center_of_mass(plate), 1)} mm."
)
