"""`resolve`: turns a scenario into one record, `ResolvedScenario`, with all that it names.

Files are read (objects and the robot's measures), what is hidden from the robot is drawn (the
object's truth and its support), and the scene is built. Then the scenario is checked as a whole:
the object lies on the table, the arm reaches it, and the finger passes over it. A simulated
station, its photograph, a twin and a real robot's station all take the record, so that nothing is
read, drawn or solved twice. Single pieces are made in `station.scene.contents`.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray
from pydrake.geometry import SceneGraph, SceneGraphInspector, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import DiagramBuilder
from shapely.geometry.base import BaseGeometry

from gridpush_drake.errors import PlanningError, ScenarioError, StationError
from gridpush_drake.geometry.se2 import transform_shape
from gridpush_drake.identification.model import Model
from gridpush_drake.multibody.contact_material import FindTableOutline
from gridpush_drake.multibody.grid_object import AddGridObject, Feet, GridObjectInPlant
from gridpush_drake.multibody.parser import AddPlantAndSceneGraph, MakeParser
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.station.robot.arm import ArmReach, CalcStartPosture, MakeControlPlant
from gridpush_drake.station.robot.gripper_tip import MeasureGripperTip
from gridpush_drake.station.robot.robot import (
    GetRobotInPlant,
    Robot,
    SetGripperOpening,
    check_robot,
    find_robot,
)
from gridpush_drake.station.scene.camera import (
    AddSeenVisual,
    FoundObject,
    PhotographedScene,
    find_object,
)
from gridpush_drake.station.scene.contents import (
    AddScene,
    CalcBasePose,
    CalcHome,
    CalcTipReach,
    MakeSupport,
    MakeTruth,
    load_object,
    load_others,
)
from gridpush_drake.station.scene.posts import place_posts
from gridpush_drake.station.scene.scatter import scatter_objects
from gridpush_drake.station.schema.scenario import PushScenario


@dataclass(frozen=True, eq=False)
class ResolvedScenario:
    """A scenario, and all that was read, drawn and solved for it.

    Attributes:
        scenario: the scenario that was resolved, with the poses that were drawn for its `scatter`;
            it must not be changed any more.
        robot: measures of the robot, and the names of its models.
        obj: the object that is pushed; its `prior` has the radius and height of the robot's finger.
        others: the other objects on the table, in the scenario's order.
        truth: true masses and frictions of the object's cells, drawn from the scenario's seed.
        support: on what the object stands; None if each cell bears its own weight.
        table_top: the part of the table where things may lie, a polygon in W, m.
        X_WR: pose of the robot's base R in the world.
        home: position p_WP of the finger's tip at the beginning, m.
        control_plant: the robot alone, as `MakeControlPlant` makes it.
        q_start: (n,) positions of the arm's joints with the tip at `home`, rad.
        scene: the plant that the scenario was checked against. A color and depth camera takes its
            photograph of it.
        source: name of the scenario's file, for messages; None if it is from no file.
    """

    scenario: PushScenario
    robot: Robot
    obj: GridObject
    others: tuple[GridObject, ...]
    truth: CellParameters
    support: Feet | None
    table_top: BaseGeometry
    X_WR: RigidTransform
    home: tuple[float, float, float]
    control_plant: MultibodyPlant
    q_start: NDArray[np.float64]
    scene: "CheckedScene"
    source: Path | str | None = None

    @cached_property
    def found(self) -> FoundObject | None:
        """The object as the camera finds it in its photograph; None with an ideal camera.

        The photograph is taken when this is first asked for: rendering takes about a second, and a
        real robot's station does not need it.

        Raises:
            ScenarioError: the camera sees no object.
            StationError: nothing can be rendered on this computer.
        """
        scene = self.scene
        if scene.builder is None or scene.object_in_plant is None:
            return None
        poses = [config.pose for config in self.scenario.others]
        photographed = PhotographedScene(
            plant=scene.plant,
            scene_graph=scene.scene_graph,
            arm=GetRobotInPlant(scene.plant, self.robot).arm,
            part=scene.object_in_plant,
            others=list(zip(scene.others, poses, strict=True)),
            q_start=self.q_start,
            table_top=self.table_top,
        )
        return find_object(self.scenario, self.obj, scene.builder, photographed)


@dataclass(frozen=True, eq=False)
class CheckedScene:
    """A finalised plant of a scene, for checks and for the camera's photograph.

    Objects are in it only if the camera renders pictures. They are there to be looked at: they have
    no collision geometry.

    Attributes:
        builder: holds the plant and its scene graph, and nothing else, for the camera to be added;
            None with an ideal camera. The Diagram is built then, because Drake's Python bindings
            keep a builder, and all that was added to it, for ever if its Diagram is never built.
        plant: robot, table and whatever else the scenario's directives add.
        scene_graph: the plant's scene graph.
        object_in_plant: the object that is pushed; None with an ideal camera.
        others: the other objects, in the scenario's order; empty with an ideal camera.
    """

    builder: DiagramBuilder | None
    plant: MultibodyPlant
    scene_graph: SceneGraph
    object_in_plant: GridObjectInPlant | None
    others: tuple[GridObjectInPlant, ...]


def resolve(
    scenario: PushScenario | ResolvedScenario,
    source: Path | str | None = None,
    *,
    known_object: GridObject | None = None,
) -> ResolvedScenario:
    """Resolves a scenario: reads, draws and builds what it names, and checks that it makes sense.

    Args:
        scenario: the scenario; one that is resolved already is returned as it is.
        source: name of the scenario's file, for messages; None if it is from no file.
        known_object: the scenario's object, if `use_object` has read it already.

    Returns:
        The record for everybody who makes something of the scenario.

    Raises:
        ScenarioError: a value will not do; the object is unknown, larger than the table, or does
            not lie on it; the finger cannot pass over the object; the workspace or the object is
            out of the arm's reach; a directive cannot be carried out. The message names `source`,
            the field and the expected form.
    """
    if isinstance(scenario, ResolvedScenario):
        return scenario
    with naming(source):
        resolved = _resolve(scenario, known_object)
    return replace(resolved, source=source)


@contextmanager
def naming(source: Path | str | None) -> Iterator[None]:
    """Puts the name of a scenario's file, if it is from one, before errors that name its fields."""
    try:
        yield
    except (ScenarioError, PlanningError) as error:
        if source is None:
            raise
        raise type(error)(f"{source}: {error}") from error


def _resolve(scenario: PushScenario, known_object: GridObject | None) -> ResolvedScenario:
    # What the scenario says by itself, and the hidden truth, which is drawn from its seed.
    scenario.check()
    obj = load_object(scenario) if known_object is None else known_object
    others = tuple(load_others(scenario))
    _check_parts(scenario, obj, others)
    truth = MakeTruth(obj, scenario.truth, scenario.seed)
    support = MakeSupport(obj, truth, scenario, scenario.seed)
    if support is not None and scenario.base != "free":
        raise ScenarioError(
            f"truth.support is {scenario.truth.support} and base {scenario.base}; "
            "expected base free, or own_weight"
        )

    # The scene and the robot in it.
    robot = find_robot(scenario.directives, scenario.packages, scenario.pusher)
    robot = replace(robot, opening=_choose_opening(scenario, robot))
    scene = _MakeScene(scenario, robot, obj, others, truth)
    plant = scene.plant
    inspector = scene.scene_graph.model_inspector()
    check_robot(plant, robot)
    SetGripperOpening(plant, robot)
    if robot.pushing_gripper is not None:
        robot = _MeasureGripper(scenario, robot, plant, inspector)
    tip_radius = robot.tip_depth
    _check_heights(scenario, tip_radius)
    table_top = FindTableOutline(plant, inspector)
    scenario = scatter_objects(scenario, obj, others, table_top)
    fields = (scenario.names.name_field(0, "object"), scenario.names.name_field(0, "pose"))
    _check_on_table(fields, obj, scenario.object_pose, table_top)
    _check_others(scenario, obj, others, table_top, tip_radius)
    _check_posts(scenario, obj, others, table_top, tip_radius)
    if robot.pushing_gripper is None:
        _check_tip(robot, plant, inspector)
    _check_reach(scenario, plant, robot)

    # The posture in which the arm begins. All controllers of the station share the control plant.
    X_WR = CalcBasePose(plant, robot)
    home = CalcHome(plant, robot)
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


def _MeasureGripper(
    scenario: PushScenario, robot: Robot, plant: MultibodyPlant, inspector: SceneGraphInspector
) -> Robot:
    """Returns the robot with what its gripper touches objects with, and how far that reaches."""
    top = max([scenario.object_height, *(other.height for other in scenario.others)])
    highest = max([top, *(post.height for post in scenario.posts)])
    height = scenario.finger.push_height
    tip = MeasureGripperTip(plant, inspector, robot, height, top=top, highest=highest)
    finger = robot.finger.model_copy(update={"tip_radius": tip.shape.reach})
    return replace(robot, tip=tip, finger=finger)


def _choose_opening(scenario: PushScenario, robot: Robot) -> float:
    """Chooses how far the fingers of a gripper that pushes are apart, m; 0 where it is closed.

    Raises:
        ScenarioError: the gripper does not open so far, or another pusher has no opening.
    """
    opening = scenario.finger.opening
    if scenario.pusher != "fingertips" or robot.pushing_gripper is None:
        if opening is not None:
            raise ScenarioError(
                f"finger.opening is {opening:g}, and pusher {scenario.pusher}; expected pusher: "
                "fingertips, or no opening"
            )
        return 0.0
    widest = robot.pushing_gripper.opening
    if opening is None:
        return HALF_OPEN * widest
    if opening > widest:
        raise ScenarioError(
            f"finger.opening is {opening:g}; expected at most {widest:g}, as far as the gripper "
            "opens (m)"
        )
    return opening


def _push_by(obj: GridObject, scenario: PushScenario, robot: Robot) -> GridObject:
    """Returns the object with the robot's finger as the pusher in its prior.

    With a planar base the object cannot tip, so that every cell bears its own weight however high
    the finger pushes: the height of the push is then left out.
    """
    height = scenario.finger.push_height if scenario.base == "free" else None
    prior = replace(obj.prior, pusher_radius=robot.finger.tip_radius, push_height=height)
    return replace(obj, prior=prior)


def _MakeScene(
    scenario: PushScenario,
    robot: Robot,
    obj: GridObject,
    others: Sequence[GridObject],
    truth: CellParameters,
) -> CheckedScene:
    """Builds the scene that is checked, and photographed by a color and depth camera."""
    builder = DiagramBuilder()
    plant, scene_graph = AddPlantAndSceneGraph(builder, scenario.simulation.time_step)
    AddScene(MakeParser(plant, robot.packages), scenario)
    object_in_plant = None
    others_in_plant = []
    if scenario.camera.kind == "rgbd":
        object_in_plant = AddGridObject(
            plant,
            scene_graph,
            Model(obj, truth),
            scenario.base,
            table=(),
            touches=False,
            height=scenario.object_height,
            visual=False,
        )
        AddSeenVisual(plant, scene_graph, object_in_plant)
        for number, (config, other) in enumerate(zip(scenario.others, others, strict=True)):
            # Nothing moves in this plant: any mass will do, and none is drawn.
            other_in_plant = AddGridObject(
                plant,
                scene_graph,
                Model(other),
                "free",
                table=(),
                touches=False,
                height=config.height,
                name=f"other_{number}",
            )
            AddSeenVisual(plant, scene_graph, other_in_plant)
            others_in_plant.append(other_in_plant)
    plant.Finalize()
    photographs = object_in_plant is not None
    if not photographs:
        builder.Build()
    return CheckedScene(
        builder=builder if photographs else None,
        plant=plant,
        scene_graph=scene_graph,
        object_in_plant=object_in_plant,
        others=tuple(others_in_plant),
    )


HALF_OPEN = 0.5
"""Fraction of its whole opening to which a gripper opens to push with both fingers."""

TIP_TOLERANCE = 1e-6
"""Greatest difference between the tip's radius in finger.yaml and in the finger's model, m."""

HEADINGS_TRIED = 36
"""Number of headings, evenly spaced, at which an object is tried to see if it fits on the table."""


def _check_parts(scenario: PushScenario, obj: GridObject, others: Sequence[GridObject]) -> None:
    """Checks that the truth of parts is given for parts that the objects have, once for each."""
    known_object = [scenario.truth.parts, *(config.parts for config in scenario.others)]
    for number, (each, parts) in enumerate(zip((obj, *others), known_object, strict=True)):
        field = scenario.names.name_field(number, "parts")
        known = np.unique(each.labels).tolist()
        labels = [part.label for part in parts]
        for at, label in enumerate(labels):
            if label not in known:
                raise ScenarioError(
                    f"{field}[{at}].label is {label}; expected a part of {each.name}: "
                    f"one of {', '.join(map(str, known))}"
                )
            if label in labels[:at]:
                raise ScenarioError(
                    f"{field}[{at}].label is {label} once more; expected each part once"
                )


def _check_heights(scenario: PushScenario, tip_radius: float) -> None:
    """Checks that the finger pushes against the object's side, and travels above it."""
    finger = scenario.finger
    height = scenario.object_height
    field = scenario.names.name_field(0, "height")
    if not tip_radius < finger.push_height <= height:
        raise ScenarioError(
            f"finger.push_height is {finger.push_height:g} m; expected more than the tip's radius, "
            f"{tip_radius:g} m, and at most the object's height, {height:g} m ({field})"
        )
    if finger.travel_height <= height + tip_radius:
        raise ScenarioError(
            f"finger.travel_height is {finger.travel_height:g} m; expected more than the object's "
            f"height ({field}) and the tip's radius, {height + tip_radius:g} m"
        )


def _check_others(
    scenario: PushScenario,
    obj: GridObject,
    others: Sequence[GridObject],
    table: BaseGeometry,
    tip_radius: float,
) -> None:
    """Checks that each other object lies on the table, apart from all others, below the finger."""
    # The field that places an object, its name, and its outline in W, of each object so far.
    names = scenario.names
    outline = transform_shape(scenario.object_pose, obj.outline)
    placed = [(names.name_field(0, "pose"), obj.name, outline)]
    for number, (config, other) in enumerate(zip(scenario.others, others, strict=True), start=1):
        field = names.name_field(number, "pose")
        _check_on_table((names.name_field(number, "object"), field), other, config.pose, table)
        if config.height + tip_radius >= scenario.finger.travel_height:
            raise ScenarioError(
                f"{names.name_field(number, 'height')} is {config.height:g} m; expected less than "
                "finger.travel_height less the tip's radius, "
                f"{scenario.finger.travel_height - tip_radius:g} m, so that the finger passes "
                "over it"
            )
        outline = transform_shape(config.pose, other.outline)
        for before_field, before_name, before in placed:
            if before.intersects(outline):
                raise ScenarioError(
                    f"{field} is {config.pose}: there {other.name} would lie in {before_name}, "
                    f"which is at {before_field}; expected room between them"
                )
        placed.append((field, other.name, outline))


def _check_posts(
    scenario: PushScenario,
    obj: GridObject,
    others: Sequence[GridObject],
    table: BaseGeometry,
    tip_radius: float,
) -> None:
    """Checks that each post stands on the table, apart from all objects, below the finger."""
    names = scenario.names
    outline = transform_shape(scenario.object_pose, obj.outline)
    lying = [(names.name_field(0, "pose"), outline)]
    for number, (config, other) in enumerate(zip(scenario.others, others, strict=True), start=1):
        outline = transform_shape(config.pose, other.outline)
        lying.append((names.name_field(number, "pose"), outline))
    for at, (post, outline) in enumerate(
        zip(scenario.posts, place_posts(scenario.posts), strict=True)
    ):
        field = f"posts[{at}]"
        x, y = post.position
        if not table.covers(outline):
            raise ScenarioError(
                f"{field}.position is [{x:g}, {y:g}]: there the post is not wholly on the table; "
                "expected a place on it"
            )
        if post.height + tip_radius >= scenario.finger.travel_height:
            raise ScenarioError(
                f"{field}.height is {post.height:g} m; expected less than finger.travel_height "
                f"less the tip's radius, {scenario.finger.travel_height - tip_radius:g} m, so that "
                "the finger passes over it"
            )
        for name, shape in lying:
            if shape.intersects(outline):
                raise ScenarioError(
                    f"{field}.position is [{x:g}, {y:g}]: there the post stands in the object of "
                    f"{name}; expected room"
                )


def _check_on_table(
    fields: tuple[str, str], obj: GridObject, pose: list[float], table: BaseGeometry
) -> None:
    """Checks that an object lies wholly on the table.

    Args:
        fields: names of the scenario's fields with the object and with its pose. The message names
            the first if the object is too large for the table, the second if it is misplaced.
        obj: the object.
        pose: (x, y, theta), X_WB, m and rad.
        table: the table's top, a polygon in W, m.
    """
    if table.covers(transform_shape(pose, obj.outline)):
        return
    object_field, pose_field = fields
    # Is the object too large, or only in the wrong place? It is tried with its bounding box in the
    # middle of the table. That is enough for tables without holes that are about round or square.
    middle = np.array(table.centroid.coords[0])
    for heading in np.linspace(0, 2 * np.pi, HEADINGS_TRIED, endpoint=False):
        turned = transform_shape([0.0, 0.0, heading], obj.outline)
        left, low, right, high = turned.bounds
        at = middle - ((left + right) / 2, (low + high) / 2)
        if table.covers(transform_shape([*at, heading], obj.outline)):
            x, y, theta = pose
            x_min, y_min, x_max, y_max = table.bounds
            raise ScenarioError(
                f"{pose_field} is [{x:g}, {y:g}, {theta:g}]: there the object is not wholly on "
                f"the table; expected a pose on it; the table spans x {x_min:g} to {x_max:g} m "
                f"and y {y_min:g} to {y_max:g} m"
            )
    raise ScenarioError(
        f"{object_field}: {obj.name}, {_describe_size(obj.outline)}, is larger than the table, "
        f"{_describe_size(table)}; expected one that can lie on it"
    )


def _check_tip(robot: Robot, plant: MultibodyPlant, inspector: SceneGraphInspector) -> None:
    """Checks that the finger touches with one sphere, as large as finger.yaml says.

    Plans and the pushing model take the tip for a circle of that radius.
    """
    model = robot.finger_model
    tip = robot.finger.tip_frame
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
    """Checks that the workspace contains the object, and a place that the arm's formula reaches.

    An arm without a formula is led there by its inverse kinematics, see `_check_workspace`.
    """
    workspace = scenario.workspace
    box = shapely.box(workspace.x[0], workspace.y[0], workspace.x[1], workspace.y[1])
    if robot.arm.reach is not None:
        p_WR, least, greatest = CalcTipReach(plant, robot, scenario.finger.push_height)
        axis = shapely.Point(p_WR)
        if box.distance(axis) >= greatest or box.hausdorff_distance(axis) <= least:
            raise ScenarioError(
                "workspace is out of the arm's reach; expected a box with points "
                f"between {least:.2f} and {greatest:.2f} m from the robot's axis"
            )
    x, y = scenario.object_pose[:2]
    if not box.covers(shapely.Point(x, y)):
        raise ScenarioError(
            f"workspace does not contain the object's position, ({x:g}, {y:g}) m; "
            "expected that it does"
        )


WORKSPACE_STEP = 0.1
"""Distance between the places of the workspace to which an arm is led as a check, m. It is coarse:
one place that is reached is enough."""


def _find_start_posture(
    robot: Robot,
    control_plant: MultibodyPlant,
    X_WR: RigidTransform,
    home: tuple[float, float, float],
) -> NDArray[np.float64]:
    """Solves for the arm's joint positions (n,) with the tip at its home, rad.

    Raises:
        ScenarioError: the arm does not reach its home.
    """
    try:
        return CalcStartPosture(control_plant, robot, home)
    except StationError as error:
        base = _describe_point(X_WR.translation())
        raise ScenarioError(
            f"directives: {robot.arm_model} on its base at {base} does not reach its home, "
            f"{_describe_point(home)}, with the finger down; expected a base about as high as the "
            "table, a home in reach, and a posture near it, where the flange's z axis points down"
        ) from error


def _check_workspace(
    scenario: PushScenario,
    robot: Robot,
    control_plant: MultibodyPlant,
    q_start: NDArray[np.float64],
    X_WR: RigidTransform,
) -> None:
    """Checks that an arm without a formula for its reach gets from its home into the workspace."""
    if robot.arm.reach is not None:
        return
    workspace = scenario.workspace
    height = scenario.finger.push_height
    bounds = (workspace.x[0], workspace.y[0], workspace.x[1], workspace.y[1])
    reach = ArmReach(control_plant, robot, q_start)
    if reach.find_region(bounds, height, WORKSPACE_STEP).is_empty:
        base = _describe_point(X_WR.translation())
        raise ScenarioError(
            "workspace is out of the arm's reach; expected a box with points that "
            f"{robot.arm_model} on its base at {base} reaches at z = {height:g} m"
        )


def _describe_point(point: ArrayLike) -> str:
    return "({:.3g}, {:.3g}, {:.3g}) m".format(*np.asarray(point, float))


def _describe_size(shape: BaseGeometry) -> str:
    left, low, right, high = shape.bounds
    return f"{right - left:.2f} x {high - low:.2f} m"
