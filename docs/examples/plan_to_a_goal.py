"""Plans pushes that bring an object to a goal pose, and carries them out in simulation."""

import numpy as np

from gridpush_drake import (
    CellParameters,
    GridObject,
    Model,
    PushConstraints,
    SupportSurface,
    plan_pushes,
)
from gridpush_drake.objects import find_shipped_object
from gridpush_drake.planning.goal import GoalRules

toolbox = GridObject.from_yaml(find_shipped_object("toolbox"))
params = CellParameters.uniform(toolbox)  # or read_model("model.yaml").params
table = SupportSurface.rectangle((0.0, 0.0), (1.2, 0.8))
rules = GoalRules(PushConstraints(table), horizon=1)
start, goal = np.array([-0.2, 0.0, 0.0]), np.array([0.15, 0.1, 0.6])

plan = plan_pushes(Model(toolbox, params), start, goal, rules)
print(f"{plan.status}: {len(plan.pushes)} pushes, {1e3 * plan.error:.1f} mm left by the plan.")

pose = start
for planned in plan.pushes:
    pose = Model(toolbox, params).simulate(planned.push, pose).final_pose
    print("  now at ({:.3f}, {:.3f}) m, turned by {:.2f} rad".format(*pose))
left = np.linalg.norm(toolbox.cells_at(pose) - toolbox.cells_at(goal), axis=1).mean()
print(f"The cells are {1e3 * left:.1f} mm from the goal on average.")
