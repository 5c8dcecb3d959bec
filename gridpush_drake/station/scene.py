"""What a scenario names, made piece by piece: objects, their truth, and the scene's models.

`station.resolve` puts it together, once, and checks that it makes sense as a whole.
"""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import (
    ModelDirectives,
    ModelInstanceInfo,
    Parser,
    ProcessModelDirectives,
)
from pydrake.multibody.plant import MultibodyPlant

from gridpush_drake.errors import ObjectError, ScenarioError
from gridpush_drake.files import is_file
from gridpush_drake.multibody.ground_truth import calc_support, sample_ground_truth
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import find_shipped_object
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.station.robot import Robot
from gridpush_drake.station.scenario import PushScenario, TruthConfig


def load_object(scenario: PushScenario) -> GridObject:
    """Reads the scenario's object; a file goes before a shipped object of the same name.

    The bounds of its friction, `prior.friction_min` and `friction_max`, are those that its file and
    the scenario's `object_friction` both allow; the prior coefficient is the file's, or the nearest
    bound.

    Raises:
        ScenarioError: there is none, its file is not what it should be, where the message suggests
            the nearest name; or scenario and file allow no common friction.
    """
    obj = _read_object(scenario.object, "object")
    return (
        obj if scenario.object_friction is None else _bound_friction(obj, *scenario.object_friction)
    )


def use_object(scenario: PushScenario, name: str) -> GridObject:
    """Gives a scenario another object, with the height that its file says; returns the object for `resolve`.

    Raises:
        ScenarioError: as `load_object`.
    """
    scenario.object = name
    obj = load_object(scenario)
    scenario.object_height = obj.height or scenario.object_height
    return obj


def load_others(scenario: PushScenario) -> list[GridObject]:
    """Reads the scenario's other objects. Raises ScenarioError as `load_object` does."""
    return [
        _read_object(other.object, f"others[{at}].object")
        for at, other in enumerate(scenario.others)
    ]


def _read_object(name: str, field: str) -> GridObject:
    path = Path(name)
    try:
        return GridObject.from_yaml(
            path if path.suffix or is_file(path) else find_shipped_object(name)
        )
    except ObjectError as error:
        raise ScenarioError(f"{field}: {error}") from error


def _bound_friction(obj: GridObject, least: float, greatest: float) -> GridObject:
    prior = obj.prior
    low, high = max(least, prior.friction_min), min(greatest, prior.friction_max)
    if low > high:
        raise ScenarioError(
            f"object_friction is [{least:g}, {greatest:g}]; expected a range that overlaps that of {obj.name}'s file, "
            f"{prior.friction_min:g} to {prior.friction_max:g}"
        )
    friction = min(max(prior.friction, low), high)
    return replace(
        obj, prior=replace(prior, friction=friction, friction_min=low, friction_max=high)
    )


def AddScene(parser: Parser, scenario: PushScenario) -> list[ModelInstanceInfo]:
    """Adds what stands in the scene besides the object to the parser's plant, before that is finalised.

    Args:
        parser: `MakeParser(plant)`.
        scenario: its `directives`, whose files `find_robot` has checked when the scenario was
            resolved.

    Returns:
        What was added.

    Raises:
        ScenarioError: a directive cannot be carried out.
    """
    directives = ModelDirectives(directives=scenario.directives)
    try:
        return ProcessModelDirectives(directives, parser)
    except (RuntimeError, ValueError) as error:
        raise ScenarioError(f"directives: {_first_line(str(error).splitlines())}") from error


def _first_line(lines: Iterable[str]) -> str:
    return next((line.strip() for line in lines if line.strip()), "cannot be carried out")


def CalcTipReach(
    plant: MultibodyPlant, robot: Robot, tip_height: float
) -> tuple[NDArray[np.float64], float, float]:
    """Calculates where the tip can be while the tool points down.

    Args:
        plant: finalised, with the robot.
        robot: the robot; it has a `reach`.
        tip_height: of the tip's center, z in W, m.

    Returns:
        The robot's axis (2,) in W, and the least and greatest distance from it, m, see
        `ReachMeasures.calc_ring`.
    """
    context = plant.CreateDefaultContext()
    flange, tip = (
        plant.GetFrameByName(name) for name in (robot.arm.flange_frame, robot.finger.tip_frame)
    )
    p_WR = CalcBasePose(plant, robot).translation()
    if robot.arm.reach is None:
        raise ScenarioError(
            f"directives: the robot.yaml of {robot.arm_model} has no reach; expected one"
        )
    length = tip.CalcPose(context, flange).translation()[2]
    return p_WR[:2].copy(), *robot.arm.reach.calc_ring(length, tip_height - p_WR[2])


def CalcBasePose(plant: MultibodyPlant, robot: Robot) -> RigidTransform:
    """Calculates X_WR of the robot's base in a finalised plant with its scene."""
    base = plant.GetFrameByName(robot.arm.base_frame)
    return base.CalcPoseInWorld(plant.CreateDefaultContext())


def CalcHome(plant: MultibodyPlant, robot: Robot) -> tuple[float, float, float]:
    """Calculates p_WP of the tip at the beginning, m, in a finalised plant with the robot's scene."""
    x, y, z = robot.arm.home
    p_WR = CalcBasePose(plant, robot).translation()
    return float(p_WR[0] + x), float(p_WR[1] + y), z


def MakeTruth(obj: GridObject, config: TruthConfig, seed: int) -> CellParameters:
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
    drawn = sample_ground_truth(
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


def MakeSupport(
    obj: GridObject, truth: CellParameters, scenario: PushScenario, seed: int
) -> NDArray[np.float64] | None:
    """How stiff the object's feet are (n,), kg, see `calc_support`; None where each cell bears its own weight.

    Args:
        obj: the object.
        truth: its masses and frictions.
        scenario: with the truth's `support` and the height of pushes.
        seed: of the draw.

    Raises:
        ScenarioError: no three feet are found that it stands on while it is pushed.
    """
    try:
        return calc_support(obj, truth, scenario.truth.support, seed, scenario.finger.push_height)
    except ObjectError as error:
        raise ScenarioError(f"truth.support: {error}") from error


def _pair(values: list[float]) -> tuple[float, float]:
    least, greatest = values
    return least, greatest
