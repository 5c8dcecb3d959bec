"""Learns an object's friction and mass from a CSV file of pushes, and predicts the next one.

With files of yours, only the two lines after "Your files" change.
"""

import numpy as np

from gridpush_drake import (
    CellParameters,
    GridObject,
    Model,
    ObservedPush,
    Push,
    PushLog,
    identify,
    write_model,
)

# In place of real pushes: a box with a heavy corner, pushed eight times, seen with noise of 0.5 mm
box = GridObject.from_outline([[0, 0], [0.16, 0], [0.16, 0.1], [0, 0.1]], max_cells=60)
box.write_yaml("box.yaml", force=True)
near = np.linalg.norm(box.p_BC - box.p_BC.max(axis=0), axis=1) < 0.06
truth = CellParameters(np.where(near, 0.03, 0.006), np.full(box.n, 0.3))
rng = np.random.default_rng(0)
rows = []
for k, place in enumerate(np.linspace(0.0, box.edges.perimeter, 8, endpoint=False)):
    push = Push.on_outline(box, place + 0.02, 0.0, 0.06, radius=0.006, speed=0.03, clearance=0.001)
    motion = Model(box, truth).simulate(push)
    some = np.linspace(0, len(motion.times) - 1, 8).astype(int)[1:]
    seen = motion.poses[some] + [0.0005, 0.0005, 0.003] * rng.standard_normal((7, 3))
    rows.append(ObservedPush(f"push_{k}", push, np.zeros(3), motion.times[some], seen))
PushLog(tuple(rows), source="an example").write_csv("pushes.csv", force=True)

# Your files: docs/howto/own_object.md and docs/howto/own_pushes.md say what stands in them
obj = GridObject.from_yaml("box.yaml")
log = PushLog.read_csv("pushes.csv")

model = identify(Model(obj), log.subset(range(7)))
print(model.message)
write_model("model.yaml", model, force=True)

(predicted,) = model.predict(log.subset([7]))
miss = obj.cells_at(predicted.poses[-1]) - obj.cells_at(log[7].final_pose)
error = np.linalg.norm(miss, axis=1).mean()
print(f"The last push is predicted with an error of {1e3 * error:.1f} mm.")
center, true = model.params.relative_friction() @ obj.p_BC, truth.relative_friction() @ box.p_BC
print(f"The center of friction is {1e3 * np.linalg.norm(center - true):.1f} mm off.")
