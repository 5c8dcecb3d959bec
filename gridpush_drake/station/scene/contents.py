"""The pieces that a scenario names, one by one: objects, hidden truth, and models of the scene.

`station.scene.resolve` puts them together, once, and checks that the scenario makes sense as a
whole.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant

from gridpush_drake.errors import ObjectError, ScenarioError
from gridpush_drake.files import is_file
from gridpush_drake.identification.model import Model
from gridpush_drake.multibody.grid_object import Feet
from gridpush_drake.multibody.ground_truth import calc_support, sample_ground_truth
from gridpush_drake.multibody.parser import ProcessDirectives
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import find_shipped_object
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.station.robot.robot import Robot
from gridpush_drake.station.scene.posts import AddPosts
from gridpush_drake.station.schema.scenario import PushScenario, TruthConfig

TOTAL_MASS_STREAM = 12
"""Number that is added to the seed for the draw of an object's total mass."""


def load_object(scenario: PushScenario, option: str | None = None) -> GridObject:
    """Reads the scenario's object, from its file or by the name of a shipped one.

    If there are both, the file is taken.

    The bounds of its friction, `prior.friction_min` and `friction_max`, are those that its file and
    the scenario's `object_friction` both allow; the prior coefficient is the file's, or the nearest
    bound.

    Args:
        scenario: the scenario.
        option: where a user named the object, for messages; None for the scenario's field.

    Raises:
        ScenarioError: there is no such object (the message suggests the nearest name); its file is
            not what it should be; or scenario and file allow no common friction.
    """
    obj = _read_object(scenario.object, option or scenario.names.name_field(0, "object"))
    if scenario.object_friction is None:
        return obj
    least, greatest = scenario.object_friction
    return _bound_friction(obj, least, greatest)


def use_object(scenario: PushScenario, name: str, option: str = "object") -> GridObject:
    """Replaces a scenario's object, and with it the object's height if its file says one.

    Args:
        scenario: the scenario, which is changed.
        name: name of a shipped object, or path of an object file.
        option: where a user named it, for the message of an error.

    Returns:
        The object that was read. Pass it to `resolve`, so that its file is read only once.

    Raises:
        ScenarioError: the object cannot be read, see `load_object`.
    """
    scenario.replace_object(name)
    obj = load_object(scenario, option)
    scenario.object_height = obj.height or scenario.object_height
    return obj


def load_others(scenario: PushScenario) -> list[GridObject]:
    """Reads the other objects on the table, in the scenario's order.

    Raises:
        ScenarioError: one of them is unknown, or its file is not what it should be.
    """
    return [
        _read_object(other.object, scenario.names.name_field(number, "object"))
        for number, other in enumerate(scenario.others, start=1)
    ]


def _read_object(name: str, field: str) -> GridObject:
    """Reads the object that a field of the scenario names; a message begins with the field."""
    path = Path(name)
    try:
        return GridObject.from_yaml(
            path if path.suffix or is_file(path) else find_shipped_object(name)
        )
    except ObjectError as error:
        raise ScenarioError(f"{field}: {error}") from error


def _bound_friction(obj: GridObject, least: float, greatest: float) -> GridObject:
    """Returns the object with its friction bounded by a range, too."""
    prior = obj.prior
    friction_min = max(least, prior.friction_min)
    friction_max = min(greatest, prior.friction_max)
    if friction_min > friction_max:
        raise ScenarioError(
            f"object_friction is [{least:g}, {greatest:g}]; expected a range that overlaps that of "
            f"{obj.name}'s file, {prior.friction_min:g} to {prior.friction_max:g}"
        )
    bounded = replace(
        prior,
        friction=min(max(prior.friction, friction_min), friction_max),
        friction_min=friction_min,
        friction_max=friction_max,
    )
    return replace(obj, prior=bounded)


def AddScene(parser: Parser, scenario: PushScenario) -> None:
    """Adds all models but the objects (robot, table, posts, whatever else) to the parser's plant.

    Args:
        parser: `MakeParser(plant, robot.packages)`; the plant is not finalised yet.
        scenario: a scenario whose `directives` are carried out. `find_robot` has checked their
            files.

    Raises:
        ScenarioError: a directive cannot be carried out.
    """
    ProcessDirectives(scenario.directives, parser)
    AddPosts(parser.plant(), scenario.posts)


def CalcTipReach(
    plant: MultibodyPlant, robot: Robot, tip_height: float
) -> tuple[NDArray[np.float64], float, float]:
    """Calculates the ring in which the tip can be while the tool points down.

    Args:
        plant: a finalised plant with the robot.
        robot: a robot whose robot.yaml has a `reach`.
        tip_height: z of the tip's center in W, m.

    Returns:
        The robot's axis (2,) in W, m, and the least and greatest distance of the tip from it, m,
        see `ReachMeasures.calc_ring`.

    Raises:
        ScenarioError: the robot has no `reach`.
    """
    if robot.arm.reach is None:
        raise ScenarioError(
            f"directives: the robot.yaml of {robot.arm_model} has no reach; expected one"
        )
    context = plant.CreateDefaultContext()
    flange = plant.GetFrameByName(robot.arm.flange_frame)
    tip = plant.GetFrameByName(robot.finger.tip_frame)
    p_WR = CalcBasePose(plant, robot).translation()
    tool_length = tip.CalcPose(context, flange).translation()[2]
    least, greatest = robot.arm.reach.calc_ring(tool_length, tip_height - p_WR[2])
    return p_WR[:2].copy(), least, greatest


def CalcBasePose(plant: MultibodyPlant, robot: Robot) -> RigidTransform:
    """Calculates X_WR of the robot's base in a finalised plant with its scene."""
    base = plant.GetFrameByName(robot.arm.base_frame)
    return base.CalcPoseInWorld(plant.CreateDefaultContext())


GRIPPER_ASIDE = 0.3
"""How far to the left of a finger's home a gripper that pushes begins, m."""


def CalcHome(plant: MultibodyPlant, robot: Robot) -> tuple[float, float, float]:
    """Calculates where the tip is at the beginning, p_WP, m, in a finalised plant with its scene.

    The robot.yaml gives x and y from the robot's base, but z from the table's top, which is z = 0.
    A gripper that pushes is wide: it begins at the side, where it hides nothing in the middle of
    the table from a camera above it.
    """
    x, y, z = robot.arm.home
    p_WR = CalcBasePose(plant, robot).translation()
    aside = 0.0 if robot.pushing_gripper is None else GRIPPER_ASIDE
    return float(p_WR[0] + x), float(p_WR[1] + y + aside), z


def MakeTruth(obj: GridObject, config: TruthConfig, seed: int) -> CellParameters:
    """Draws an object's true masses and frictions, and puts those that are given in their place.

    Args:
        obj: the object.
        config: ranges of the draw, and the true values that are given for some of the parts.
        seed: seed of the draw.

    Returns:
        The true parameters of the object's cells.

    Raises:
        ScenarioError: values are given for a part that the object does not have.
    """
    drawn = sample_ground_truth(
        obj,
        seed,
        cell_mass_range=_pair(config.cell_mass),
        friction_range=_pair(config.friction),
        contact_friction_range=_pair(config.contact_friction),
        friction_by_part=config.friction_by_part,
    )
    mass = drawn.mass.copy()
    friction = drawn.friction.copy()
    if config.total_mass is not None:
        low, high = np.log(config.total_mass)
        total = np.exp(np.random.default_rng((seed, TOTAL_MASS_STREAM)).uniform(low, high))
        mass *= total / mass.sum()
    for at, part in enumerate(config.parts):
        cells = obj.labels == part.label
        if not cells.any():
            known = ", ".join(map(str, np.unique(obj.labels).tolist()))
            raise ScenarioError(
                f"truth.parts[{at}].label is {part.label}; expected a part of {obj.name}: "
                f"one of {known}"
            )
        if part.cell_mass is not None:
            mass[cells] = part.cell_mass
        if part.friction is not None:
            friction[cells] = part.friction
    return CellParameters(mass, friction, drawn.contact_friction)


def MakeSupport(
    obj: GridObject, truth: CellParameters, scenario: PushScenario, seed: int
) -> Feet | None:
    """Draws on what the object stands, as its scenario's `truth.support` says.

    Args:
        obj: the object.
        truth: its true masses and frictions.
        scenario: the scenario, with the kind of support and the height at which is pushed.
        seed: seed of the draw.

    Returns:
        A foot below each cell, see `calc_support`; None if each cell bears its own weight.

    Raises:
        ScenarioError: no three feet are found on which the object does not tip when it is pushed.
    """
    try:
        return calc_support(
            Model(obj, truth),
            scenario.truth.support,
            seed,
            scenario.finger.push_height,
            scenario.truth.rim_gap,
        )
    except ObjectError as error:
        raise ScenarioError(f"truth.support: {error}") from error


def _pair(values: list[float]) -> tuple[float, float]:
    least, greatest = values
    return least, greatest
