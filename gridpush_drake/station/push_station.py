"""`MakePushStation`: table, object, robot with a finger, camera, executor and identifier in one Diagram.

The station knows the object's outline. What its cells weigh and how they rub, the truth, goes to
the plant alone; everything else in the station sees the object through its camera, and the finger's
tip through the joints.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np
from pydrake.geometry import (
    GeometryId,
    Meshcat,
    MeshcatVisualizer,
    MeshcatVisualizerParams,
    Role,
    SceneGraph,
)
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.systems.framework import Context, Diagram, DiagramBuilder

from gridpush_drake.display.server import KeepToItsThread
from gridpush_drake.geometry.se2 import wrap_angle
from gridpush_drake.multibody.contact_material import TABLE, SetPartner
from gridpush_drake.multibody.grid_object import AddGridObject, Base, GridObjectInPlant
from gridpush_drake.multibody.ground_truth import (
    SetGridObjectParameters,
    SetGridObjectPose,
    resample_parameters,
)
from gridpush_drake.multibody.parser import AddVisualMeshes, MakeParser, find_drake_models
from gridpush_drake.multibody.weak_calc import NO_SLOTS
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.perception.sight import Sight
from gridpush_drake.station.arm import (
    DRIVER_OUTPUTS,
    AddArmDriver,
    SetJointServos,
)
from gridpush_drake.station.camera import (
    LOST_BELOW,
    AddIdealCamera,
    AddPoseEstimator,
    AddRgbdCamera,
    AddSeenVisual,
    FoundObject,
    StationCamera,
    calc_pose_age,
)
from gridpush_drake.station.grasping import AddGripperController, ExportOutputs
from gridpush_drake.station.others import AddOtherCameras, AddOthers, SetOthersStart
from gridpush_drake.station.resolve import ResolvedScenario, resolve
from gridpush_drake.station.robot import GetRobotInPlant, Robot, RobotInPlant
from gridpush_drake.station.scenario import PushScenario
from gridpush_drake.station.scene import (
    AddScene,
    MakeSupport,
    MakeTruth,
)
from gridpush_drake.station.station import (
    POSE_LOG,
    AddRobotControl,
    Learning,
    MakeSetting,
    RobotControl,
    Setting,
    Station,
)
from gridpush_drake.systems.planar_pose_sensor import PlanarPoseSensor
from gridpush_drake.systems.pusher_state_sensor import PusherStateSensor
from gridpush_drake.systems.true_parameters import TrueParameters

TRUE_LOG, COVARIANCE_LOG = "true_pose_log", "covariance_log"
"""Names of the systems that log how well a color and depth camera sees."""


@dataclass(frozen=True)
class Sensors:
    """What `AddSensors` put into a builder.

    Attributes:
        camera: sees the object, with noise.
        ground_truth: sees it as it is, for display and judgment.
        tip: knows where the tip is and how it moves.
    """

    camera: StationCamera
    ground_truth: PlanarPoseSensor
    tip: PusherStateSensor


def AddSensors(
    builder: DiagramBuilder,
    scene_graph: SceneGraph,
    scenario: PushScenario,
    robot: Robot,
    part: GridObjectInPlant,
    found: FoundObject | None,
) -> Sensors:
    """Adds the sensors, and connects them to the plant; `found` is what a color and depth camera tracks."""
    plant, body, period = part.plant, part.body.index(), 1 / scenario.camera.rate
    ground_truth = PlanarPoseSensor(body, period=period, lowest=LOST_BELOW)
    sensors = Sensors(
        StationCamera(AddIdealCamera(builder, part, scenario.camera, "camera", scenario.seed))
        if found is None
        else _add_rgbd_camera(builder, scene_graph, scenario, part, found),
        builder.AddNamedSystem("ground_truth_sensor", ground_truth),
        builder.AddNamedSystem(
            "tip_sensor", PusherStateSensor(plant.GetBodyByName(robot.finger.tip_frame).index())
        ),
    )
    tip = sensors.tip
    for sensor in (sensors.ground_truth, tip):
        builder.Connect(plant.get_body_poses_output_port(), sensor.GetInputPort("body_poses"))
    builder.Connect(
        plant.get_body_spatial_velocities_output_port(), tip.GetInputPort("body_spatial_velocities")
    )
    return sensors


def _add_rgbd_camera(
    builder: DiagramBuilder,
    scene_graph: SceneGraph,
    scenario: PushScenario,
    part: GridObjectInPlant,
    found: FoundObject,
) -> StationCamera:
    rgbd = AddRgbdCamera(builder, part.plant, scene_graph, scenario, part)
    return StationCamera(AddPoseEstimator(builder, rgbd, scenario, found), rgbd.noise)


def AddStationScene(
    plant: MultibodyPlant, scene_graph: SceneGraph, scenario: PushScenario, robot: Robot
) -> tuple[RobotInPlant, tuple[GeometryId, ...]]:
    """Adds what the directives say; returns the robot and the table's collision geometries."""
    AddScene(MakeParser(plant), scenario)
    # a plant's own GetCollisionGeometriesForBody gives ids that keep it alive, unseen by the
    # garbage collector
    inspector = scene_graph.model_inspector()
    table = tuple(
        geometry
        for body in plant.GetBodyIndices(plant.GetModelInstanceByName(TABLE))
        for geometry in inspector.GetGeometries(plant.GetBodyFrameIdOrThrow(body), Role.kProximity)
    )
    tip = plant.GetBodyByName(robot.finger.tip_frame)
    SetPartner(plant, scene_graph, [*table, *plant.GetCollisionGeometriesForBody(tip)])
    instances = GetRobotInPlant(plant, robot)
    SetJointServos(plant, robot, instances.arm)
    return instances, table


@dataclass(frozen=True, eq=False)
class World:
    """The simulated part of a station: the plant with robot, object and table, and what is known of it.

    Attributes:
        resolved: the scenario that it is made from.
        setting: what the robot knows; the plant is the world's.
        true_obj: the plant's object, on whose cells the truth is drawn.
        truth: what it weighs and how it rubs by the scenario's seed, on the cells of `setting.obj`.
        scene_graph: of the plant.
        robot_in_plant: the robot's model instances.
        object_in_plant: the object.
        table: the table's collision geometries.
    """

    resolved: ResolvedScenario
    setting: Setting
    true_obj: GridObject
    truth: CellParameters
    scene_graph: SceneGraph
    robot_in_plant: RobotInPlant
    object_in_plant: GridObjectInPlant
    table: tuple[GeometryId, ...]

    @property
    def plant(self) -> MultibodyPlant:
        """The plant."""
        return self.setting.plant

    def SetStart(
        self, diagram: Diagram, root_context: Context, seed: int | None
    ) -> CellParameters | None:
        """Puts arm and object where the scenario has them, at rest.

        Args:
            diagram: has the plant.
            root_context: of it, or of a Diagram that it is part of.
            seed: of the hidden truth, instead of the scenario's; None leaves that as it is.

        Returns:
            The truth on the cells of `setting.obj`; None where it was left as it is.
        """
        plant, scenario, arm = self.plant, self.setting.scenario, self.robot_in_plant.arm
        plant_context = plant.GetMyMutableContextFromRoot(root_context)
        plant.SetPositions(plant_context, arm, self.setting.q_start)
        plant.SetVelocities(plant_context, arm, np.zeros_like(self.setting.q_start))
        SetGridObjectPose(plant, plant_context, self.object_in_plant, scenario.object_pose)
        if seed is None:
            return None
        resolved = self.resolved
        truth, support = resolved.truth, resolved.support
        if seed != resolved.scenario.seed:
            truth = MakeTruth(self.true_obj, scenario.truth, seed)
            support = MakeSupport(self.true_obj, truth, scenario, seed)
        SetGridObjectParameters(
            plant, self.scene_graph, root_context, self.object_in_plant, truth, support
        )
        if truth is resolved.truth:
            return self.truth
        return resample_parameters(self.true_obj, truth, self.setting.obj)


def AddWorld(
    builder: DiagramBuilder,
    resolved: ResolvedScenario,
    show_object: bool = True,
    drake_models: Path | None = None,
) -> World:
    """Adds the plant with all that a scenario has, finalised.

    Args:
        builder: empty.
        resolved: what stands where.
        show_object: whether the object's plain outline is shown.
        drake_models: folder of the meshes that the robot is shown with; None for its primitives.

    Returns:
        The world.

    Raises:
        ScenarioError: the camera does not see an object.
        StationError: nothing can be rendered here.
    """
    scenario, robot, found = resolved.scenario, resolved.robot, resolved.found
    true_obj = resolved.obj if found is None else found.true_obj

    # The plant: scene, object, other objects.
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, scenario.simulation.time_step)
    plant.set_name("plant")
    plant.set_stiction_tolerance(scenario.simulation.stiction_tolerance)
    scene_graph.set_name("scene_graph")
    instances, table = AddStationScene(plant, scene_graph, scenario, robot)
    object_in_plant = AddGridObject(
        plant,
        scene_graph,
        true_obj,
        resolved.truth,
        cast(Base, scenario.base),
        table=table,
        height=scenario.object_height,
        support=resolved.support,
        visual=show_object,
    )
    others = AddOthers(plant, scene_graph, scenario, resolved.others, table, object_in_plant)
    if found is not None:
        AddSeenVisual(plant, scene_graph, object_in_plant)
        seen = {
            "object_pose": found.pose.tolist(),
            "object_height": found.obj.height or scenario.object_height,
        }
        scenario = scenario.model_copy(update=seen)
    if drake_models is not None:
        AddVisualMeshes(plant, scene_graph, drake_models)
    plant.Finalize()

    # What the robot knows of it, and what only the world knows.
    setting = MakeSetting(resolved, scenario, plant, found, others)
    plant.SetDefaultPositions(instances.arm, setting.q_start)
    return World(
        resolved=resolved,
        setting=setting,
        true_obj=true_obj,
        truth=resample_parameters(true_obj, resolved.truth, setting.obj),
        scene_graph=scene_graph,
        robot_in_plant=instances,
        object_in_plant=object_in_plant,
        table=table,
    )


class PushStation(Station):
    """The simulated station, with handles on what it was made from.

    Beside the ports of every `Station` it has these.

    .. pydrake_system::

        name: PushStation
        output_ports:
        - object.pose_true
        - body_poses
        - contact_results
        - query_object
        - other_0.pose
        - ...

    - ``object.pose_true``: (3,) as it is, for display and judgment; the three after: the plant's
      own.
    - ``other_0.pose`` and so on: (3,) of each of the scenario's other objects, as ``object.pose``.

    Attributes:
        scene_graph: of the plant.
        robot_in_plant: the robot's model instances in the plant.
        object_in_plant: the object in the plant.
        table: the table's collision geometries.
        gripper: its model instance; None where the scene has none.
    """

    __slots__ = NO_SLOTS

    def __init__(
        self,
        builder: DiagramBuilder,
        world: World,
        control: RobotControl,
        camera: StationCamera,
        other_cameras: tuple[PlanarPoseSensor, ...],
        true_parameters: TrueParameters,
        meshcat: Meshcat | None,
    ) -> None:
        """Takes over a builder's systems; `MakePushStation` calls it."""
        super().__init__(builder, world.setting, control, world.truth)
        self._world, self._camera, self._other_cameras = world, camera, other_cameras
        self._kinematics, self._true_parameters = control.kinematics, true_parameters
        self.scene_graph, self.object_in_plant, self.table = (
            world.scene_graph,
            world.object_in_plant,
            world.table,
        )
        self.robot_in_plant, self.gripper = world.robot_in_plant, world.robot_in_plant.gripper
        self._meshcat = meshcat  # the visualizer in C++ keeps only the server, and `KeepToItsThread` asks for this

    def SetStart(self, root_context: Context, seed: int | None = None) -> None:
        """Puts arm and object where the scenario has them, at rest. Call it on every fresh Context.

        Args:
            root_context: of the station, or of the Diagram it is part of.
            seed: of the hidden truth and the camera's noise, instead of the scenario's: one Diagram
                serves many runs.
        """
        truth = self._world.SetStart(self, root_context, seed)
        kinematics_context = self._kinematics.GetMyMutableContextFromRoot(root_context)
        self._kinematics.SetPositions(kinematics_context, self._world.setting.q_start)
        SetOthersStart(
            self.plant, self.scene_graph, root_context, self.scenario, self.others, self._other_cameras,
            self.scenario.seed if seed is None else seed,
        )  # fmt: skip
        if seed is not None and truth is not None:
            self._true_parameters.SetParameters(root_context, truth)
            self._camera.SetSeed(root_context, seed)

    def GetTruth(self, root_context: Context) -> CellParameters:
        """What the plant's object really weighs and how it rubs in a Context, as `SetStart` left it.

        Args:
            root_context: of the station, or of the Diagram it is part of.
        """
        return self._true_parameters.GetParameters(root_context)

    def FindSight(self, root_context: Context) -> Sight | None:
        """What the color and depth camera saw in a Context, and how far off that was; None for an ideal camera.

        Args:
            root_context: of the station, or of the Diagram it is part of.
        """
        if self.found is None:
            return None
        (t, poses), (_, true), (_, covariance) = (
            self._find_log(root_context, name) for name in (POSE_LOG, TRUE_LOG, COVARIANCE_LOG)
        )
        late = round(calc_pose_age(self.scenario.camera) * self.scenario.camera.rate) - 1
        errors = poses[late:] - true[: len(true) - late]
        errors[:, 2] = wrap_angle(errors[:, 2])
        std = np.sqrt(covariance[late:].reshape(-1, 3, 3).diagonal(axis1=1, axis2=2))
        return Sight(self.found.detected.close_up, t[late:], errors, std)

    def CoverCamera(self, root_context: Context, covered: bool = True) -> None:
        """Covers the camera, which then sees no object, or uncovers it."""
        self._camera.SetCovered(root_context, covered)


def MakePushStation(
    scenario: PushScenario | ResolvedScenario,
    meshcat: Meshcat | None = None,
    *,
    show_object: bool = True,
    learning: Learning | None = None,
    name: str = "station",
) -> PushStation:
    """Makes the station.

    Building one takes far longer than to begin anew: for many runs build it once, and give every
    run a fresh Context (`CreateDefaultContext`, then `SetStart`), or `Simulator.reset_context` with
    one. All that differs between two runs is in the Context; two runs of one station may be
    interleaved. A station that nobody holds any more is freed by Python's garbage collector
    (`gc.collect()`) but for 1 MB or less that stays with Drake. Whoever keeps a `RigidBody`, a
    `Joint`, a `Frame` or the ids of `GetCollisionGeometriesForBody` of its plant as a part of the
    station, or of what it is connected to, keeps all of it for good: keep their indices instead.

    Args:
        scenario: what stands where, resolved or not.
        meshcat: to show it in; None for none.
        show_object: whether the object's plain outline is shown; not where its estimate is drawn in
            its place.
        learning: what is learned from; the first `scenario.pokes.count` pushes by default.
        name: of the station in a Diagram, and of what is shown in Meshcat; stations in one Diagram
            have names of their own.

    Returns:
        The station. Call its `SetStart` on each new Context.

    Raises:
        ScenarioError: the scenario makes no sense, see `resolve`.
        StationError: nothing can be rendered here.
    """
    builder = DiagramBuilder()
    resolved = resolve(scenario)
    world = AddWorld(
        builder, resolved, show_object, find_drake_models() if meshcat is not None else None
    )
    setting, plant, arm = world.setting, world.plant, world.robot_in_plant.arm
    seen = setting.scenario
    gripper, found = world.robot_in_plant.gripper, setting.found
    driver = AddArmDriver(builder, plant, setting.robot, arm, setting.control_plant)
    sensors = AddSensors(
        builder, world.scene_graph, seen, setting.robot, world.object_in_plant, found
    )
    camera, true_pose = sensors.camera.source, sensors.ground_truth.GetOutputPort("object_pose")
    other_cameras = AddOtherCameras(builder, seen, setting.others)
    true_parameters = builder.AddNamedSystem("truth", TrueParameters(world.truth))
    control = AddRobotControl(
        builder,
        setting,
        learning,
        sensors.tip.GetOutputPort("pusher_state"),
        camera.GetOutputPort("object_pose"),
        None if gripper is None else plant.get_state_output_port(gripper),
        None
        if found is None
        else {TRUE_LOG: true_pose, COVARIANCE_LOG: camera.GetOutputPort("covariance")},
    )
    builder.Connect(
        control.kinematics.GetOutputPort("joint_positions"), driver.GetInputPort("position")
    )
    if control.grasping is not None:
        assert setting.robot.gripper is not None
        hand = AddGripperController(builder, plant, gripper, setting.robot.gripper)
        builder.Connect(
            control.grasping.GetOutputPort("gripper_position"),
            hand.get_desired_position_input_port(),
        )
        builder.Connect(
            control.grasping.GetOutputPort("gripper_force_limit"), hand.get_force_limit_input_port()
        )
    if meshcat is not None:
        AddMeshcat(builder, world.scene_graph, meshcat, name)
    if found is not None:
        ExportOutputs(builder, camera, "camera", ("covariance", "seen"))
    builder.ExportOutput(true_pose, "object.pose_true")
    ExportOutputs(builder, driver, setting.robot.arm_model, DRIVER_OUTPUTS)
    builder.ExportOutput(plant.get_body_poses_output_port(), "body_poses")
    builder.ExportOutput(plant.get_contact_results_output_port(), "contact_results")
    builder.ExportOutput(world.scene_graph.get_query_output_port(), "query_object")
    station = PushStation(
        builder, world, control, sensors.camera, other_cameras, true_parameters, meshcat
    )
    station.set_name(name)
    return station


def AddMeshcat(
    builder: DiagramBuilder, scene_graph: SceneGraph, meshcat: Meshcat, prefix: str = "station"
) -> MeshcatVisualizer:
    """Shows the illustration geometry, and nothing else, below the path `prefix`."""
    KeepToItsThread(meshcat)
    params = MeshcatVisualizerParams(role=Role.kIllustration, prefix=prefix)
    return MeshcatVisualizer.AddToBuilder(builder, scene_graph, meshcat, params)
