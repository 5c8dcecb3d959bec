"""Pushes that are safe though the model may be wrong.

A push is made only as far as it keeps the rules, with some leeway, not just by the model but by every sample: other
models that may be the true one. By each of them its own center of friction must also stay over the table. Samples are
drawn from the posterior; before anything was learned they are objects heavier towards one side,

    k_i ~ exp(a u · (p_i - c) / r),   u all around,   r the farthest cell's distance from the cells' centroid c,

little (a small) and much: where a push turns an object to either side, the worst is often in between.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.dynamics.time_grid import make_path_times
from gridpush_drake.geometry.se2 import Array, make_direction, transform
from gridpush_drake.identification.result import Identification
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.contact.trial import ContactOptions, PlannedPush
from gridpush_drake.planning.push_constraints import PushConstraints


@dataclass(frozen=True)
class RobustnessOptions:
    """How many other models may be the true one, and what must hold by all of them.

    Attributes:
        samples: from the posterior that a push is tried with.
        tilts: a above: how uneven an object may be of which nothing is known.
        sides: directions u of each.
        leeway: m by which cells may hang over further by a sample than by the model.
        center_margin: m by which the center of friction must stay over the table.
        seed: of the draws.
    """

    samples: int = 6
    tilts: tuple[float, ...] = (1.0, 2.0)
    sides: int = 4
    leeway: float = 0.03
    center_margin: float = 0.03
    seed: int = 0


def draw_model_samples(
    obj: GridObject, params: CellParameters, identification: Identification | None, options: RobustnessOptions
) -> list[CellParameters]:
    """Other models that may be the true one.

    Args:
        obj: the object.
        params: the model.
        identification: that it comes from; None where nothing was learned.
        options: how many, and how uneven.

    Returns:
        The models.
    """
    if identification is not None:
        return identification.samples(options.samples, options.seed)
    arm = obj.p_BC - obj.p_BC.mean(axis=0)
    farthest = max(float(np.linalg.norm(arm, axis=1).max()), obj.cell_size)
    # along the object's longest axis first, where unevenness matters most
    axis = np.linalg.eigh(arm.T @ arm)[1][:, -1]
    turns = np.arctan2(axis[1], axis[0]) + 2 * np.pi * np.arange(options.sides) / options.sides
    slopes = make_direction(turns) @ arm.T / farthest
    return [replace(params, mass=params.mass * np.exp(tilt * slope)) for tilt in options.tilts for slope in slopes]


@dataclass(eq=False)
class Robustness:
    """Cuts pushes short; counts the simulations it takes.

    Attributes:
        obj: the object.
        models: the model first, then the samples.
        constraints: the rules.
        contact: what pushes are made like.
        options: what must hold.
        simulations: run so far.
    """

    obj: GridObject
    models: Sequence[CellParameters]
    constraints: PushConstraints
    contact: ContactOptions
    options: RobustnessOptions
    simulations: int = 0

    def cut(self, pose: Array, planned: PlannedPush) -> PlannedPush | None:
        """The part of a push from `pose` that is safe by all models; None where that is nothing."""
        if self.constraints.surface is None and not self.constraints.obstacles:
            return planned
        times = make_path_times(planned.push, self.contact.regime)
        rules = replace(
            self.constraints, edge_margin=self.constraints.edge_margin - self.options.leeway, pose_rule=None
        )
        checker = rules.start_at(self.obj, pose, self.contact.radius)
        usable, nominal = len(times), None
        for params in self.models:
            motion = simulate(self.obj, params, planned.push, pose, times=times, regime=self.contact.regime)
            self.simulations += 1
            nominal = motion.poses if nominal is None else nominal
            usable = min(
                usable, checker.count_allowed(motion.tip, motion.poses), self._count_supported(params, motion.poses)
            )
        distance = self.contact.speed * times[usable - 1] if usable else 0.0
        if nominal is None or distance < self.contact.distance_range[0]:
            return None
        if usable == len(times):
            return planned
        whole = planned.push
        push = Push(
            whole.start, whole.velocity, float(times[usable - 1]), whole.radius, start_tangent=whole.start_tangent
        )
        return replace(planned, distance=float(distance), push=push, pose=nominal[usable - 1].copy())

    def _count_supported(self, params: CellParameters, poses: Array) -> int:
        """How many of the poses, from the first on, keep the model's center of friction over the table."""
        surface = self.constraints.surface
        if surface is None:
            return len(poses)
        center = (params.relative_friction() @ self.obj.p_BC)[None]
        room = surface.signed_distances(transform(poses, center)[:, 0])
        held = room >= min(self.options.center_margin, float(room[0])) - 1e-9
        return len(poses) if held.all() else int(np.argmin(held))
