"""`resolve`: a scenario made into one record, once, for everybody who makes something of it.

What the scenario names is read (objects and the robot's measures), what is hidden is drawn (truth
and support), the scene is built, and whether all of it makes sense is checked against that: the
object lies on the table, the arm gets to it, and the finger clears it. A station, its photograph,
a twin and a real robot's station take the record and read, draw and solve nothing again.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray
from pydrake.geometry import SceneGraph, SceneGraphInspector, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.systems.framework import DiagramBuilder
from shapely.geometry.base import BaseGeometry

from gridpush_drake.errors import ScenarioError, StationError
from gridpush_drake.geometry.se2 import transform_shape
from gridpush_drake.multibody.contact_material import FindTableOutline
from gridpush_drake.multibody.grid_object import AddGridObject, GridObjectInPlant
from gridpush_drake.multibody.parser import MakeParser
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.station.arm import ArmReach, CalcStartPosture, MakeControlPlant
from gridpush_drake.station.camera import (
    AddSeenVisual,
    FoundObject,
    PhotographedScene,
    find_object,
)
from gridpush_drake.station.robot import GetRobotInPlant, Robot, check_robot, find_robot
from gridpush_drake.station.scenario import PushScenario
from gridpush_drake.station.scene import (
    AddScene,
    CalcBasePose,
    CalcHome,
    CalcTipReach,
    MakeSupport,
    MakeTruth,
    load_object,
    load_others,
)


@dataclass(frozen=True, eq=False)
class ResolvedScenario:
    """A scenario with all that it stands for.

    Attributes:
        scenario: what it was made from; not to be changed any more.
        robot: its measures.
        obj: the object that is pushed, with the finger as its pusher.
        others: the other objects, in the scenario's order.
        truth: what the object weighs and how it rubs, by the scenario's seed.
        support: how stiff the object's feet are (n,), kg; None where each cell bears its own weight.
        table_top: where on the table things may lie, a polygon in W, m.
        X_WR: pose of the robot's base.
        home: p_WP of the tip at the beginning, m.
        control_plant: the robot alone, as `MakeControlPlant` makes it.
        q_start: (n,) the arm's posture at home, rad.
        scene: what the scenario was checked against; with a color and depth camera, what it
            photographs.
    """

    scenario: PushScenario
    robot: Robot
    obj: GridObject
    others: tuple[GridObject, ...]
    truth: CellParameters
    support: NDArray[np.float64] | None
    table_top: BaseGeometry
    X_WR: RigidTransform
    home: tuple[float, float, float]
    control_plant: MultibodyPlant
    q_start: NDArray[np.float64]
    scene: "CheckedScene"

    @cached_property
    def found(self) -> FoundObject | None:
        """What the camera makes of its photograph, taken when first asked for; None with an ideal camera.

        Raises:
            ScenarioError: the camera does not see an object there.
            StationError: nothing can be rendered here.
        """
        scene = self.scene
        if self.scenario.camera.kind == "ideal" or scene.part is None:
            return None
        arm = GetRobotInPlant(scene.plant, self.robot).arm
        poses = [config.pose for config in self.scenario.others]
        photographed = PhotographedScene(
            plant=scene.plant,
            scene_graph=scene.scene_graph,
            arm=arm,
            part=scene.part,
            others=list(zip(scene.others, poses, strict=True)),
            q_start=self.q_start,
            table_top=self.table_top,
        )
        return find_object(self.scenario, self.obj, scene.builder, photographed)


@dataclass(frozen=True, eq=False)
class CheckedScene:
    """A plant with what stands in a scene, finalised, in a builder of its own.

    Attributes:
        builder: with nothing else in it.
        plant: of the scene.
        scene_graph: of the plant.
        part: the object, as a camera sees it; None where no camera looks.
        others: the other objects, likewise.
    """

    builder: DiagramBuilder
    plant: MultibodyPlant
    scene_graph: SceneGraph
    part: GridObjectInPlant | None
    others: tuple[GridObjectInPlant, ...]


def resolve(
    scenario: PushScenario | ResolvedScenario,
    source: Path | str | None = None,
    *,
    told: GridObject | None = None,
) -> ResolvedScenario:
    """Resolves a scenario: reads, draws and builds what it names, and checks that it makes sense.

    Args:
        scenario: what stands where; one that is resolved already is given back.
        source: the file that it is from, for messages.
        told: the scenario's object, where it was read already (`use_object`).

    Raises:
        ScenarioError: a value will not do; the object is unknown, larger than the table, or does
            not lie on it; the finger cannot clear the object; the workspace or the object is out of
            the arm's reach; a directive cannot be carried out. The message names the file,
            `source`, where there is one, the field and the expected form.
    """
    if isinstance(scenario, ResolvedScenario):
        return scenario
    try:
        return _resolve(scenario, told)
    except ScenarioError as error:
        raise ScenarioError(f"{source}: {error}" if source else str(error)) from error


def _resolve(scenario: PushScenario, told: GridObject | None) -> ResolvedScenario:
    # What the scenario says by itself, and the hidden truth by its seed.
    scenario.check()
    obj = load_object(scenario) if told is None else told
    _check_parts(scenario)
    truth = MakeTruth(obj, scenario.truth, scenario.seed)
    support = MakeSupport(obj, truth, scenario, scenario.seed)
    if support is not None and scenario.base != "free":
        raise ScenarioError(
            f"truth.support is {scenario.truth.support} and base {scenario.base}; expected base free, or own_weight"
        )
    others = tuple(load_others(scenario))

    # The scene and the robot in it.
    scene = _MakeScene(scenario, obj, others, truth)
    plant, inspector = scene.plant, scene.scene_graph.model_inspector()
    robot = find_robot(scenario.directives)
    check_robot(plant, robot)
    tip_radius = robot.finger.tip_radius
    _check_heights(scenario, tip_radius)
    table_top = FindTableOutline(plant, inspector)
    _check_on_table(("object", "object_pose"), obj, scenario.object_pose, table_top)
    _check_others(scenario, obj, others, table_top, tip_radius)
    _check_tip(robot, plant, inspector)
    _check_reach(scenario, plant, robot)

    # Where the arm begins. The control plant serves all controllers of the station, too.
    X_WR, home = CalcBasePose(plant, robot), CalcHome(plant, robot)
    control_plant = MakeControlPlant(robot, X_WR)
    q_start = _find_start_posture(robot, control_plant, X_WR, home)
    _check_workspace(scenario, robot, control_plant, q_start, X_WR)
    return ResolvedScenario(
        scenario=scenario,
        robot=robot,
        obj=_push_by(obj, scenario, robot),
        others=others,
        truth=truth,
        support=support,
        table_top=table_top,
        X_WR=X_WR,
        home=home,
        control_plant=control_plant,
        q_start=q_start,
        scene=scene,
    )


def _push_by(obj: GridObject, scenario: PushScenario, robot: Robot) -> GridObject:
    """The object with the robot's finger as its pusher.

    In a planar plant every cell bears its own weight, however high it is pushed.
    """
    height = scenario.finger.push_height if scenario.base == "free" else None
    prior = replace(obj.prior, pusher_radius=robot.finger.tip_radius, push_height=height)
    return replace(obj, prior=prior)


def _MakeScene(
    scenario: PushScenario, obj: GridObject, others: Sequence[GridObject], truth: CellParameters
) -> CheckedScene:
    """Builds the scene; with a color and depth camera also the objects, which are only looked at."""
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, scenario.simulation.time_step)
    AddScene(MakeParser(plant), scenario)
    part, seen = None, []
    if scenario.camera.kind == "rgbd":
        part = AddGridObject(
            plant,
            scene_graph,
            obj,
            truth,
            scenario.base,
            table=(),
            touches=False,
            height=scenario.object_height,
            visual=False,
        )
        AddSeenVisual(plant, scene_graph, part)
        for number, (config, other) in enumerate(zip(scenario.others, others, strict=True)):
            beside = AddGridObject(
                plant,
                scene_graph,
                other,
                CellParameters.uniform(other),
                "free",
                table=(),
                touches=False,
                height=config.height,
                name=f"other_{number}",
            )
            AddSeenVisual(plant, scene_graph, beside)
            seen.append(beside)
    plant.Finalize()
    return CheckedScene(builder, plant, scene_graph, part, tuple(seen))


TIP_TOLERANCE = 1e-6
"""m, between the measured tip radius and the model's."""

TURNS = 36
"""Headings that are tried where the object does not lie on the table, to say whether it could."""


def _check_parts(scenario: PushScenario) -> None:
    labels = [part.label for part in scenario.truth.parts]
    for at, label in enumerate(labels):
        if label in labels[:at]:
            raise ScenarioError(
                f"truth.parts[{at}].label is {label} once more; expected each part once"
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
    scenario: PushScenario,
    obj: GridObject,
    others: Sequence[GridObject],
    table: BaseGeometry,
    tip_radius: float,
) -> None:
    lying = [("object_pose", transform_shape(scenario.object_pose, obj.outline))]
    for at, (config, other) in enumerate(zip(scenario.others, others, strict=True)):
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


WORKSPACE_STEP = 0.1
"""m, between places of the workspace that an arm is asked about."""


def _find_start_posture(
    robot: Robot,
    control_plant: MultibodyPlant,
    X_WR: RigidTransform,
    home: tuple[float, float, float],
) -> NDArray[np.float64]:
    """The arm's posture (n,) at its home, rad. Raises ScenarioError where it does not get there."""
    try:
        return CalcStartPosture(control_plant, robot, home)
    except StationError as error:
        base = _describe_point(X_WR.translation())
        raise ScenarioError(
            f"directives: {robot.arm_model} on its base at {base} does not reach its home, {_describe_point(home)}, "
            "with the finger down; expected a base about as high as the table, a home in reach, and a posture near it, "
            "where the flange's z axis points down"
        ) from error


def _check_workspace(
    scenario: PushScenario,
    robot: Robot,
    control_plant: MultibodyPlant,
    q_start: NDArray[np.float64],
    X_WR: RigidTransform,
) -> None:
    """That the arm reaches some of the workspace from its home, where no formula of the robot says it."""
    if robot.arm.reach is not None:
        return
    workspace, height = scenario.workspace, scenario.finger.push_height
    bounds = (workspace.x[0], workspace.y[0], workspace.x[1], workspace.y[1])
    reach = ArmReach(control_plant, robot, q_start)
    if reach.find_region(bounds, height, WORKSPACE_STEP).is_empty:
        base = _describe_point(X_WR.translation())
        raise ScenarioError(
            f"workspace is out of the arm's reach; expected a box with points that {robot.arm_model} on its base at "
            f"{base} reaches at z = {height:g} m"
        )


def _describe_point(point: ArrayLike) -> str:
    return "({:.3g}, {:.3g}, {:.3g}) m".format(*np.asarray(point, float))


def _describe_size(shape: BaseGeometry) -> str:
    left, low, right, high = shape.bounds
    return f"{right - left:.2f} x {high - low:.2f} m"
