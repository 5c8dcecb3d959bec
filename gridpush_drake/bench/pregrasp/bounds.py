"""What bounds of the friction decide in pre-grasp sliding, whether they hold or not.

Pushes show each cell's relative friction alone, and bounds of the friction turn it into masses that
the object may have (`planning.plausible_masses`). Here that relative friction is known exactly,
so that nothing but the bounds is in doubt: is there a goal that is safe for all those masses, and
does the object stay put there with its true ones? No method that rests on bounds does better.
Objects of rubber and steel are told bounds that hold, and others that do not.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely

from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.plausible_masses import PlausibleMassSet
from gridpush_drake.planning.pregrasp.goals import GoalOptions, find_pregrasp_goals
from gridpush_drake.planning.pregrasp.grasp.grasp_parts import GraspPart
from gridpush_drake.planning.pregrasp.stability import calc_stability_margin
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.report.table import Column, Proportion, Table
from gridpush_drake.units import MM_PER_M, PERCENT_PER_ONE

RUBBER_FRICTION = 0.8
"""Friction of a part of rubber."""

STEEL_FRICTION = 0.2
"""Friction of a part of steel."""

KNOWN_FRICTION_BOUNDS = {
    f"{low:g} to {high:g}": (low, high)
    for low, high in ((STEEL_FRICTION, RUBBER_FRICTION), (0.2, 0.6), (0.25, 0.5), (0.3, 0.4))
}
"""Bounds of the friction that the method is told of such objects; the first ones hold."""

DRAWN_EXPERIMENT = "drawn"
"""Name of the experiment with objects of known relative friction, drawn within what is told."""

KNOWN_EXPERIMENTS = {f"known, {key}": bounds for key, bounds in KNOWN_FRICTION_BOUNDS.items()}
"""Experiments with objects of known relative friction that are partly of rubber, by their names,
with the bounds that are told."""


def draw_materials(obj: GridObject, mass_set: int) -> Array:
    """Draws frictions (n,) of an object of which one part is of rubber, and the others of steel."""
    rng = np.random.default_rng([mass_set, 2])
    return np.where(
        obj.labels == rng.choice(np.unique(obj.labels)), RUBBER_FRICTION, STEEL_FRICTION
    )


def describe_fraction(count: int, total: int) -> str:
    """Writes a fraction in percent, and its interval."""
    fraction = Proportion.of(count, total)
    return (
        f"{PERCENT_PER_ONE * count / total:.0f} "
        f"({PERCENT_PER_ONE * fraction.low:.0f}-{PERCENT_PER_ONE * fraction.high:.0f})"
    )


@dataclass(frozen=True)
class BoundsScore:
    """One object with known relative friction.

    Attributes:
        method: DRAWN_EXPERIMENT, or one of KNOWN_EXPERIMENTS.
        safe: whether there is a goal that is safe for all masses within the bounds.
        tips: whether the object tips at the best such goal.
        outside: how far the true center of mass is outside the region that the bounds leave, m.
    """

    method: str
    safe: bool
    tips: bool
    outside: float


def judge_bounds(
    obj: GridObject,
    truth: CellParameters,
    parts: Sequence[GraspPart],
    surface: SupportSurface,
    max_arm: float,
    method: str,
) -> BoundsScore:
    """Judges the bounds of an object's friction, with the object at the table's middle.

    Args:
        obj: the object, whose prior has the bounds.
        truth: its true masses and frictions.
        parts: where it can be grasped.
        surface: the table.
        max_arm: greatest distance of the grasp from where the center of mass is believed, m.
        method: DRAWN_EXPERIMENT, or one of KNOWN_EXPERIMENTS.
    """
    # The masses that are possible within the bounds, and how far the truth is from them.
    friction = truth.relative_friction()[None]
    masses = PlausibleMassSet(
        obj, friction / obj.prior.friction_max, friction / obj.prior.friction_min
    )
    centers = masses.center_of_mass_polygon
    outside = float(shapely.Polygon(centers).distance(shapely.Point(truth.center_of_mass(obj))))

    # The best goal that is safe for all of them, and whether the true masses tip there.
    near = [part for part in parts if np.linalg.norm(part.p_BG - masses.middle) <= max_arm]
    goals = find_pregrasp_goals(masses, near, np.zeros(3), surface) if near else []
    if not goals or goals[0].margin < GoalOptions().margin:
        return BoundsScore(method=method, safe=False, tips=False, outside=outside)
    true = PlausibleMassSet.of_masses(Model(obj, truth))
    margin = calc_stability_margin(true, goals[0].pose, surface, 0.0)
    return BoundsScore(method=method, safe=True, tips=margin < 0, outside=outside)


BOUNDS_COLUMNS: dict[str, Column] = {
    "objects": len,
    "safe goal, %": lambda scores: describe_fraction(
        sum(each.safe for each in scores), len(scores)
    ),
    "tips there, %": lambda scores: describe_fraction(
        sum(each.tips for each in scores), len(scores)
    ),
    "center outside": lambda scores: sum(each.outside > 0 for each in scores),
    "worst, mm": lambda scores: MM_PER_M * max(each.outside for each in scores),
}


def tabulate_bounds(scores: Sequence[BoundsScore], friction: tuple[float, float]) -> Table:
    """Tabulates what the bounds allow, and where they mislead."""
    label = f"{friction[0]:g} to {friction[1]:g}"
    names = {
        DRAWN_EXPERIMENT: f"{label}, drawn",
        **{
            key: f"{friction_bounds}, rubber"
            for key, friction_bounds in zip(KNOWN_EXPERIMENTS, KNOWN_FRICTION_BOUNDS, strict=True)
        },
    }
    groups = [
        ((name,), [score for score in scores if score.method == key]) for key, name in names.items()
    ]
    notes = (
        "Told are bounds of the friction: of what is drawn within them, or of one part of rubber, "
        f"{RUBBER_FRICTION:g}, with others of steel, {STEEL_FRICTION:g}. The relative friction is "
        "known exactly.",
        "safe goal: one where no masses within the bounds tip the object. tips there: the true "
        "ones do.",
        "center outside: objects whose true center of mass is outside the region that the bounds "
        "leave, and how far.",
    )
    return Table.of("What bounds of the friction allow", ("told",), groups, BOUNDS_COLUMNS, notes)
