"""The poke that is expected to tell most of the center of mass, of those that are safe.

Which pokes there are, and how they compare, is calculated in `exploration`, and what the chosen one
is expected to leave in `poke_forecast`. Here pokes are held to the table, to what else lies there,
and to what the arm can reach.
"""

from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike
from shapely import Polygon

from gridpush_drake.planning.pregrasp.decision import PreGraspOptions
from gridpush_drake.planning.pregrasp.exploration import (
    PokeChoice,
    calc_worst_std,
    choose_poke,
    make_center_functional,
    make_farthest_functional,
    make_pokes,
)
from gridpush_drake.planning.pregrasp.goals import ANY_ARM, ArmLimits
from gridpush_drake.planning.pregrasp.poke_forecast import Functional, forecast_std
from gridpush_drake.planning.pregrasp.slides import OBSTACLE_MARGIN, make_stability_rule
from gridpush_drake.planning.pregrasp.uncertainty import UncertainModel
from gridpush_drake.planning.push_constraints import PushConstraints
from gridpush_drake.planning.support_surface import SupportSurface


def suggest_poke(
    model: UncertainModel,
    pose: ArrayLike,
    surface: SupportSurface,
    direction: ArrayLike | None = None,
    options: PreGraspOptions | None = None,
    limits: ArmLimits = ANY_ARM,
    obstacles: tuple[Polygon, ...] = (),
) -> PokeChoice | None:
    """Chooses the poke that is expected to tell most of the center of mass.

    Args:
        model: of the object; its `posterior` must not be None.
        pose: (3,) where the object lies, X_WB, m and rad.
        surface: the table, inside whose edge the object stays, or at least as far in and as stable
            as it is.
        direction: (2,) unit vector in the body frame along which it matters how far the center can
            be; where None, the center matters.
        options: how pokes are made, and what they keep to.
        limits: of the arm.
        obstacles: what else lies on the table, polygons in W, m, which object and finger keep clear
            of.

    Returns:
        The poke; None where none keeps the object on the table.

    Raises:
        PlanningError: the model leaves nothing to learn.
    """
    options = options or PreGraspOptions()
    rule = make_stability_rule(
        model.masses, pose, surface, options.slide.margin, options.slide.inset
    )
    constraints = PushConstraints(
        surface,
        obstacles,
        edge_margin=options.poke_margin,
        obstacle_margin=OBSTACLE_MARGIN,
        pose_rule=rule,
        finger_region=limits.finger_region,
        push_rule=limits.can_push,
    )
    pokes = make_pokes(model, pose, options.poke, constraints)
    if not pokes:
        return None
    make_functional: Functional = make_center_functional
    if direction is not None:
        make_functional = partial(make_farthest_functional, direction=direction)
    choice = choose_poke(model, pose, pokes, make_functional(model))
    # The arm is asked last, for that takes longest: the best poke first, until it can make one.
    for index in np.argsort(choice.expected_stds, kind="stable").tolist():
        expected = float(choice.expected_stds[index])
        if np.isfinite(expected) and constraints.allows_push(pokes[index]):
            imagined = forecast_std(model, pokes[index], pose, make_functional)
            expected = expected if imagined is None else imagined
            return replace(choice, push=pokes[index], index=index, expected_std=expected)
    return None


def calc_center_std(model: UncertainModel) -> float:
    """Standard deviation of the center of mass in the direction in which it is known least, m."""
    if model.posterior is None:
        return 0.0
    F = make_center_functional(model)
    return calc_worst_std(F @ model.posterior.covariance @ F.T)
