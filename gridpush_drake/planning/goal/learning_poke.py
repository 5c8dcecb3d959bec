"""A poke on the way to a goal, made to learn an object anew.

An object that moved unlike what was learned of it is not pushed on by a model that is wrong. First
it is poked where that is expected to tell most of its center of friction (`DesignedPokes`), within
the rules that pushes to the goal keep to: on the table, clear of obstacles, and so short that it is
safe by every model that may be the true one (`next_push.Robustness`).
"""

import numpy as np
from shapely import Point

from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.geometry.se2 import Array, rotate, transform_back
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.result import Identification
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.belief import Belief
from gridpush_drake.planning.contact.trial import PlannedPush, calc_goal_error
from gridpush_drake.planning.exploration.designed_pokes import DesignedPokes, PokeOptions
from gridpush_drake.planning.goal.next_push import GoalRules, Robustness, draw_model_samples
from gridpush_drake.pushes.push_log import PushLog


def choose_poke_within(
    rules: GoalRules, pose: Array, found: Identification, log: PushLog, goal: Array
) -> PlannedPush | None:
    """Chooses the poke that is expected to tell most of the center of friction.

    Args:
        rules: what pushes to the goal keep to.
        pose: (3,) where the object lies, X_WB, m and rad.
        found: what was learned of it.
        log: the pushes that it was learned from, at least.
        goal: (3,) the goal, of which the plan says how far off the poke leaves the object.

    Returns:
        The poke; None where no poke keeps to the rules.
    """
    obj = found.obj
    used = log.subset([i for i, seen in enumerate(log) if seen.name in found.push_names])
    model = Belief.of_identification(found, log=used)
    contact = rules.contact
    options = PokeOptions(
        contact.pusher,
        distance=min(PokeOptions.distance, contact.distance_range[1]),
    )
    robustness = None
    if rules.robustness is not None:
        robustness = Robustness(
            obj=obj,
            models=[
                found.params,
                *draw_model_samples(Model(obj, found.params), found, rules.robustness),
            ],
            constraints=rules.constraints,
            contact=contact,
            options=rules.robustness,
        )
    # where each poke that was cut to what is safe by all models is predicted to end
    planned_of: dict[Push, PlannedPush] = {}

    def cut(poke: Push) -> Push | None:
        planned = _plan(found, poke, pose, goal)
        if robustness is not None:
            safe = robustness.cut(pose, planned)
            if safe is None:
                return None
            planned = safe.planned
        planned_of[planned.push] = planned
        return planned.push

    proposal = DesignedPokes(options, cut=cut).propose(model, pose, rules.constraints)
    return None if proposal.push is None else planned_of[proposal.push]


def _plan(found: Identification, push: Push, pose: Array, goal: Array) -> PlannedPush:
    """Says of a poke where it begins, and where the model puts the object at its end."""
    obj = found.obj
    motion = simulate(Model(obj, found.params), push, pose, regime="quasi_static")
    arc_length, angle = _find_contact(obj, push, pose)
    return PlannedPush(
        arc_length=arc_length,
        angle=angle,
        distance=push.length,
        push=push,
        pose=motion.final_pose,
        cost=float(calc_goal_error(obj, motion.final_pose, goal)),
        simulations=1,
    )


def _find_contact(obj: GridObject, push: Push, pose: Array) -> tuple[float, float]:
    """Finds where on the outline a push begins, m, and its angle from the inward normal, rad."""
    start = transform_back(pose, push.start[None])[0]
    arc_length = float(obj.outline.exterior.project(Point(start)))
    _, _, normal = obj.edges.at(arc_length)
    inward = -np.asarray(normal)
    direction = rotate(-pose[2], push.velocity / np.linalg.norm(push.velocity))
    across = inward[0] * direction[1] - inward[1] * direction[0]
    return arc_length, float(np.arctan2(across, inward @ direction))
