"""What a scenario names, made: the object, its truth and the scene's models; and whether it makes sense as a whole.

The object lies on the table, the arm gets to it, and the finger clears it.
"""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray
from pydrake.geometry import SceneGraph, SceneGraphInspector, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import (
    ModelDirectives,
    ModelInstanceInfo,
    Parser,
    ProcessModelDirectives,
)
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.systems.framework import DiagramBuilder
from shapely.geometry.base import BaseGeometry

from gridpush_drake.errors import ObjectError, ScenarioError, StationError
from gridpush_drake.files import is_file
from gridpush_drake.geometry.se2 import transform_shape
from gridpush_drake.multibody.contact_material import FindTableOutline
from gridpush_drake.multibody.ground_truth import calc_support, sample_ground_truth
from gridpush_drake.multibody.parser import MakeParser
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import find_shipped_object
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.station.arm import ArmReach, CalcStartPosture, MakeControlPlant
from gridpush_drake.station.robot import Robot, check_robot, find_robot
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


def use_object(scenario: PushScenario, name: str) -> None:
    """Gives a scenario another object, with the height that its file says.

    Raises:
        ScenarioError: as `load_object`.
    """
    scenario.object = name
    scenario.object_height = load_object(scenario).height or scenario.object_height


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
        scenario: its `directives`.

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


TIP_TOLERANCE = 1e-6
"""m, between the measured tip radius and the model's."""

TURNS = 36
"""Headings that are tried where the object does not lie on the table, to say whether it could."""


def check_scenario(scenario: PushScenario, source: Path | None = None) -> Robot:
    """Checks that a scenario can be built and makes sense; returns its robot.

    Raises:
        ScenarioError: a value will not do; the object is unknown, larger than the table, or does
            not lie on it; the finger cannot clear the object; the workspace or the object is out of
            the arm's reach; a directive cannot be carried out. The message names the file,
            `source`, where there is one, the field and the expected form.
    """
    try:
        return _check_scenario(scenario)
    except ScenarioError as error:
        raise ScenarioError(f"{source}: {error}" if source else str(error)) from error


def _check_scenario(scenario: PushScenario) -> Robot:
    scenario.check()
    obj = load_object(scenario)
    _check_truth(scenario, obj)
    plant, scene_graph = ParseScene(scenario)
    robot = find_robot(scenario.directives)
    check_robot(plant, robot)
    _check_heights(scenario, robot.finger.tip_radius)
    inspector = scene_graph.model_inspector()
    table = FindTableOutline(plant, inspector)
    _check_on_table(("object", "object_pose"), obj, scenario.object_pose, table)
    _check_others(scenario, obj, table, robot.finger.tip_radius)
    _check_tip(robot, plant, inspector)
    _check_reach(scenario, plant, robot)
    return robot


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


def ParseScene(scenario: PushScenario) -> tuple[MultibodyPlant, SceneGraph]:
    """Makes a plant, finalised, of what stands in the scene besides the object; it is part of no Diagram."""
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, scenario.simulation.time_step)
    AddScene(MakeParser(plant), scenario)
    plant.Finalize()
    return plant, scene_graph


def _check_truth(scenario: PushScenario, obj: GridObject) -> None:
    labels = [part.label for part in scenario.truth.parts]
    for at, label in enumerate(labels):
        if label in labels[:at]:
            raise ScenarioError(
                f"truth.parts[{at}].label is {label} once more; expected each part once"
            )
    truth = MakeTruth(obj, scenario.truth, scenario.seed)
    support = MakeSupport(obj, truth, scenario, scenario.seed)
    if support is not None and scenario.base != "free":
        raise ScenarioError(
            f"truth.support is {scenario.truth.support} and base {scenario.base}; expected base free, or own_weight"
        )


def _check_heights(scenario: PushScenario, tip_radius: float) -> None:
    finger, height = scenario.finger, scenario.object_height
    if not tip_radius < finger.push_height <= height:
        raise ScenarioError(
            f"finger.push_height is {finger.push_height:g} m; expected more than the tip's radius, "
            f"{tip_radius:g} m, and at most the object's height, {height:g} m"
        )
    if finger.travel_height <= height + tip_radius:
        raise ScenarioError(
            f"finger.travel_height is {finger.travel_height:g} m; expected more than the object's height "
            f"and the tip's radius, {height + tip_radius:g} m"
        )


def _check_others(
    scenario: PushScenario, obj: GridObject, table: BaseGeometry, tip_radius: float
) -> None:
    lying = [("object_pose", transform_shape(scenario.object_pose, obj.outline))]
    for at, (config, other) in enumerate(zip(scenario.others, load_others(scenario), strict=True)):
        field = f"others[{at}].pose"
        _check_on_table((f"others[{at}].object", field), other, config.pose, table)
        if config.height + tip_radius >= scenario.finger.travel_height:
            raise ScenarioError(
                f"others[{at}].height is {config.height:g} m; expected less than finger.travel_height "
                f"less the tip's radius, {scenario.finger.travel_height - tip_radius:g} m, so that the finger passes "
                "over it"
            )
        outline = transform_shape(config.pose, other.outline)
        for name, before in lying:
            if before.intersects(outline):
                raise ScenarioError(
                    f"{field} is {config.pose}: there the object lies in that of {name}; expected room"
                )
        lying.append((field, outline))


def _check_on_table(
    fields: tuple[str, str], obj: GridObject, pose: list[float], table: BaseGeometry
) -> None:
    """Of the `fields` a message names the first where the object is too large, the second where it is misplaced."""
    if table.covers(transform_shape(pose, obj.outline)):
        return
    middle = np.array(table.centroid.coords[0])
    for turn in np.linspace(0, 2 * np.pi, TURNS, endpoint=False):
        turned = transform_shape([0.0, 0.0, turn], obj.outline)
        left, low, right, high = turned.bounds
        at = middle - ((left + right) / 2, (low + high) / 2)
        if table.covers(transform_shape([*at, turn], obj.outline)):
            x, y, theta = pose
            near, far = table.bounds[:2], table.bounds[2:]
            raise ScenarioError(
                f"{fields[1]} is [{x:g}, {y:g}, {theta:g}]: there the object is not wholly on the table; expected "
                f"a pose on it; the table spans x {near[0]:g} to {far[0]:g} m and y {near[1]:g} to {far[1]:g} m"
            )
    raise ScenarioError(
        f"{fields[0]}: {obj.name}, {_describe_size(obj.outline)}, is larger than the table, {_describe_size(table)}; "
        "expected one that can lie on it"
    )


def _check_tip(robot: Robot, plant: MultibodyPlant, inspector: SceneGraphInspector) -> None:
    model, tip = robot.finger_model, robot.finger.tip_frame
    body = plant.GetBodyByName(tip, plant.GetModelInstanceByName(model))
    shapes = [
        inspector.GetShape(geometry) for geometry in plant.GetCollisionGeometriesForBody(body)
    ]
    radii = [shape.radius() for shape in shapes if isinstance(shape, Sphere)]
    if len(radii) != 1 or len(shapes) != 1:
        raise ScenarioError(
            f"directives: body {model}::{tip} must have one sphere, and nothing else, to touch with"
        )
    if abs(radii[0] - robot.finger.tip_radius) > TIP_TOLERANCE:
        raise ScenarioError(
            f"finger.yaml: tip_radius is {robot.finger.tip_radius:g} m; "
            f"expected {radii[0]:g} m, as the finger's model has it"
        )


def _check_reach(scenario: PushScenario, plant: MultibodyPlant, robot: Robot) -> None:
    workspace = scenario.workspace
    box = shapely.box(workspace.x[0], workspace.y[0], workspace.x[1], workspace.y[1])
    if robot.arm.reach is not None:
        p_WR, least, greatest = CalcTipReach(plant, robot, scenario.finger.push_height)
        reach, axis = (
            f"between {least:.2f} and {greatest:.2f} m from the robot's axis",
            shapely.Point(p_WR),
        )
        if box.distance(axis) >= greatest or box.hausdorff_distance(axis) <= least:
            raise ScenarioError(
                f"workspace is out of the arm's reach; expected a box with points {reach}"
            )
    x, y = scenario.object_pose[:2]
    if not box.covers(shapely.Point(x, y)):
        raise ScenarioError(
            f"workspace does not contain the object's position, ({x:g}, {y:g}) m; expected that it does"
        )
    _check_home(scenario, plant, robot, box)


WORKSPACE_STEP = 0.1
"""m, between places of the workspace that an arm is asked about."""


def _check_home(
    scenario: PushScenario, plant: MultibodyPlant, robot: Robot, box: BaseGeometry
) -> None:
    """That the arm reaches its home and, where no formula says it, the workspace from there."""
    X_WR, home = CalcBasePose(plant, robot), CalcHome(plant, robot)
    control_plant, base = MakeControlPlant(robot, X_WR), _describe_point(X_WR.translation())
    try:
        q_start = CalcStartPosture(control_plant, robot, home)
    except StationError as error:
        raise ScenarioError(
            f"directives: {robot.arm_model} on its base at {base} does not reach its home, {_describe_point(home)}, "
            "with the finger down; expected a base about as high as the table, a home in reach, and a posture near it, "
            "where the flange's z axis points down"
        ) from error
    height = scenario.finger.push_height
    reach = ArmReach(control_plant, robot, q_start)
    if robot.arm.reach is None and reach.find_region(box.bounds, height, WORKSPACE_STEP).is_empty:
        raise ScenarioError(
            f"workspace is out of the arm's reach; expected a box with points that {robot.arm_model} on its base at "
            f"{base} reaches at z = {height:g} m"
        )


def _describe_point(point: ArrayLike) -> str:
    return "({:.3g}, {:.3g}, {:.3g}) m".format(*np.asarray(point, float))


def _describe_size(shape: BaseGeometry) -> str:
    left, low, right, high = shape.bounds
    return f"{right - left:.2f} x {high - low:.2f} m"


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
