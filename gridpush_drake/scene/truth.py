"""What an object weighs and how it rubs, drawn at random and hidden from whoever is to find out."""

from typing import TYPE_CHECKING, Any

import numpy as np

from gridpush_drake.errors import ScenarioError
from gridpush_drake.grid.object import GridObject
from gridpush_drake.grid.parameters import DEFAULT_TOTAL_MASS, CellParameters

if TYPE_CHECKING:
    from gridpush_drake.scene.scenario import TruthConfig

Range = tuple[float, float]

CELL_MASS_RANGE = (0.1, 1.0)
"""Least and greatest mass of a cell before all are scaled to the object's total mass; one draw a part."""

FRICTION_RANGE = (0.2, 0.6)
CONTACT_FRICTION_RANGE = (0.35, 0.65)


def hide_truth(
    obj: GridObject,
    seed: int,
    *,
    cell_mass_range: Range = CELL_MASS_RANGE,
    friction_range: Range = FRICTION_RANGE,
    contact_friction_range: Range = CONTACT_FRICTION_RANGE,
    friction_by_part: bool = False,
) -> CellParameters:
    """Draws what the parts weigh and how they rub; the total mass is the object's, or DEFAULT_TOTAL_MASS.

    Args:
        obj: the object.
        seed: of the draw.
        cell_mass_range: of a cell's mass before all are scaled to the total, kg; log-uniform, one draw a part.
        friction_range: of the coefficient against the support.
        contact_friction_range: of the coefficient against the pusher.
        friction_by_part: whether every part has a friction of its own. Slow pushes cannot tell mass and friction apart,
            and the centre of mass can only be learned where they do not vary both.

    Returns:
        The truth.
    """
    drawn = CellParameters.random(obj, seed, cell_mass_range, friction_range if friction_by_part else None)
    total = obj.prior.total_mass or DEFAULT_TOTAL_MASS
    rng = np.random.default_rng((seed, 1))
    contact_friction = float(rng.uniform(*contact_friction_range))
    friction = drawn.friction if friction_by_part else np.full(obj.n, rng.uniform(*friction_range))
    return CellParameters(drawn.mass * (total / drawn.total_mass), friction, contact_friction)


def MakeTruth(obj: GridObject, config: "TruthConfig", seed: int) -> CellParameters:
    """Draws what a scenario says of an object's truth, and sets what it gives.

    Args:
        obj: the object.
        config: ranges, and what is given for some parts.
        seed: of the draw.

    Returns:
        The truth.

    Raises:
        ScenarioError: a part is given that the object does not have.
    """
    drawn = hide_truth(
        obj,
        seed,
        cell_mass_range=_pair(config.cell_mass),
        friction_range=_pair(config.friction),
        contact_friction_range=_pair(config.contact_friction),
        friction_by_part=config.friction_by_part,
    )
    mass, friction = drawn.mass.copy(), drawn.friction.copy()
    for at, part in enumerate(config.parts):
        cells = obj.labels == part.label
        if not cells.any():
            known = ", ".join(map(str, np.unique(obj.labels).tolist()))
            raise ScenarioError(
                f"truth.parts[{at}].label is {part.label}; expected a part of {obj.name}: one of {known}"
            )
        if part.cell_mass is not None:
            mass[cells] = part.cell_mass
        if part.friction is not None:
            friction[cells] = part.friction
    return CellParameters(mass, friction, drawn.contact_friction)


def _pair(values: list[float]) -> Range:
    least, greatest = values
    return least, greatest


def describe_truth(obj: GridObject, truth: CellParameters) -> dict[str, Any]:
    """The truth by part, for a file that people read."""
    parts = []
    for label in np.unique(obj.labels).tolist():
        first = int(np.argmax(obj.labels == label))
        parts.append(
            {
                "part": label,
                "cells": int((obj.labels == label).sum()),
                "cell_mass": float(truth.mass[first]),
                "friction": float(truth.friction[first]),
                "relative_friction": float(truth.relative_friction()[obj.labels == label].sum()),
            }
        )
    return {
        "object": obj.name,
        "total_mass": truth.total_mass,
        "centre_of_mass": truth.centre_of_mass(obj).tolist(),
        "centre_of_friction": (truth.relative_friction() @ obj.p_BC).tolist(),
        "contact_friction": truth.contact_friction,
        "parts": parts,
    }
