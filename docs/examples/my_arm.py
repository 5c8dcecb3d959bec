"""An arm at a table pushes an object: here a UR5e; with `robot: FOLDER` one of yours (docs/extending.md)."""

from pathlib import Path

import numpy as np
from pydrake.systems.analysis import Simulator

from gridpush_drake import MakePushStation, PushCommand, read_scenario

Path("cell.yaml").write_text("{robot: ur5e, object: open_book, object_pose: [0.55, 0.0, 0.0]}")
scenario = read_scenario("cell.yaml")
station = MakePushStation(scenario)
simulator = Simulator(station)
context = simulator.get_mutable_context()
station.SetStart(context)

# From a place beside the book, 6 cm along y, at 6 cm/s
command = PushCommand(command_id=1, x=0.6, y=-0.13, direction=np.pi / 2, distance=0.06, speed=0.06)
obstacle = station.FindObstacle(command)
print(f"Can the arm do it? {obstacle or 'Yes.'}")
station.GetInputPort("push_command").FixValue(context, command.to_vector())

status = station.GetOutputPort("executor.status")
while status.Eval(context).executed == 0:
    simulator.AdvanceTo(context.get_time() + 0.1)
pose = station.GetOutputPort("object.pose").Eval(context)
print(
    f"After {context.get_time():.1f} s the book lies at ({pose[0]:.3f}, {pose[1]:.3f}) m, "
    f"turned by {np.degrees(pose[2]):.0f} degrees."
)
